"""Networks of OpenPCDet and mmdetection3d, as `lidcam train convert` writes them.

They measure heights from the lidar, which stood at one height above the ground in all of their data, and need
intensities. This module converts both to that scale, starting from the ground that was found.
"""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.model import NotNegative, Positive, SettingsModel
from lidcam.pipeline.detectors.onnx.session import OnnxSession
from lidcam.pipeline.detectors.pillars.decoding import Found
from lidcam.pipeline.detectors.pillars.network import FoundClass, specs_in

KEY = "lidcam.kit"
"""Name under which the metadata of a file holds its `KitSpecs`."""

KIT_INPUTS = "features", "pillar"
"""(R, F) float32 and (R, 1) int64, see `kit_pillars`."""

KIT_OUTPUTS = "boxes", "log_odds"
"""(K, 8) float32: centre, length, width and height in the kit's frame, metres; sine and cosine of the heading. And (K,
C) float32 log odds of each class."""

Feature = Literal[
    "x", "y", "z", "intensity", "zero", "dx_mean", "dy_mean", "dz_mean", "dx_cell", "dy_cell", "dz_cell", "distance"
]
"""Features that a kit uses of a point: its place, its intensity, its offset from the mean of the points of its pillar
and from the middle of the pillar, its distance from the lidar. Zero stands for values that lidcam does not know (the
age of a sweep, which is 0 for the last one; elongation)."""

MAX_SIDE = 2048


class KitGrid(SettingsModel):
    """The pillars of a kit, from one corner up to another, which is excluded; in rows along y."""

    low_m: tuple[float, float, float]  # Corner of the lowest coordinates, x, y, z from the lidar
    high_z_m: float  # Points at this height or higher are left out
    cell_m: tuple[Positive, Positive]  # Sides of a pillar along x and y
    # Pillars along x and y
    cells: tuple[Annotated[int, Field(ge=1, le=MAX_SIDE)], Annotated[int, Field(ge=1, le=MAX_SIDE)]]

    @property
    def high_m(self) -> tuple[float, float, float]:
        """Corner of the highest coordinates."""
        x, y = (low + side * cells for low, side, cells in zip(self.low_m[:2], self.cell_m, self.cells, strict=True))
        return x, y, self.high_z_m


class KitSpecs(SettingsModel):
    """Metadata of a file."""

    classes: Annotated[tuple[FoundClass, ...], Field(min_length=1)]  # Classes of its output, in order
    features: Annotated[tuple[Feature, ...], Field(min_length=3)]  # Features of its points, in order
    # Points that the kit puts into a pillar. If there are fewer, the kit leaves places empty, and these count as points
    # of zeros; 0: it leaves none empty
    max_points: Annotated[int, Field(ge=0, le=1024)]
    grid: KitGrid  # Its grid
    ground_z_m: float  # Height of the ground in its data, from the lidar
    intensity_max: NotNegative  # The highest intensity in its data


def kit_pillars(position: F64, intensity: F32, specs: KitSpecs) -> tuple[F32, I64]:
    """The features that a kit uses of the points within its grid.

    Args:
        position: (N, 3) x and y from the middle of the lidars, and height above the ground, metres.
        intensity: (N,) from 0 to 1.
        specs: Specs of the network.

    Returns:
        (R, F) float32 features of points, sorted by pillar, and in the order of the cloud within a pillar; then a row
        of zeros per pillar that is not full. And (R, 1) the pillar of each: its row times the number of columns, plus
        its column.
    """
    grid = specs.grid
    xyz = position + np.array([0.0, 0.0, specs.ground_z_m])
    column_row = np.floor((xyz[:, :2] - grid.low_m[:2]) / grid.cell_m)
    inside = ((column_row >= 0) & (column_row < grid.cells)).all(1)
    inside &= (xyz[:, 2] >= grid.low_m[2]) & (xyz[:, 2] < grid.high_z_m)
    pillar = (column_row[inside] @ [1, grid.cells[0]]).astype(np.int64)
    order = np.argsort(pillar, kind="stable")
    rows, pillar = np.flatnonzero(inside)[order], pillar[order]
    xyz, column_row = xyz[rows], column_row[rows]
    _, starts, counts = np.unique(pillar, return_index=True, return_counts=True)
    means = np.add.reduceat(xyz, starts) / counts[:, None] if len(starts) else xyz
    middle = np.append(
        (column_row + 0.5) * grid.cell_m, np.full((len(rows), 1), (grid.high_z_m - grid.low_m[2]) / 2), 1
    )
    columns: dict[Feature, F64] = {
        "intensity": np.asarray(intensity[rows] * specs.intensity_max, np.float64),
        "zero": np.zeros(len(rows)),
        "distance": np.linalg.norm(xyz, axis=1),
    }
    named: tuple[tuple[tuple[Feature, Feature, Feature], F64], ...] = (
        (("x", "y", "z"), xyz),
        (("dx_mean", "dy_mean", "dz_mean"), xyz - np.repeat(means, counts, 0)),
        (("dx_cell", "dy_cell", "dz_cell"), xyz - (middle + grid.low_m)),
    )
    columns |= {name: part[:, axis] for names, part in named for axis, name in enumerate(names)}
    features = np.column_stack([columns[name] for name in specs.features])
    empty = pillar[starts[counts < specs.max_points]]
    features = np.concatenate([features, np.zeros((len(empty), len(specs.features)))])
    return features.astype(np.float32), np.append(pillar, empty)[:, None]


class KitNetwork:
    """A loaded network."""

    def __init__(self, path: Path, session: OnnxSession) -> None:
        """Take a file; raises ModelError if what it says about itself is wrong."""
        self._path, self._session = path, session
        self.specs = specs_in(session, path, KEY, KitSpecs, "a 3D network that `lidcam train convert` wrote")
        self.classes, self.cell_m = self.specs.classes, max(self.specs.grid.cell_m)
        names, expected = [name for name, _, _ in session.outputs], [*KIT_OUTPUTS]
        if names != expected or len(session.inputs) != len(KIT_INPUTS):
            raise ModelError(f"{path}: expected outputs {expected}, found {names}, or other inputs: convert it anew")

    def reaches(self, xy: F64) -> Bools:
        """(N,) whether places (N, 2) that are relative to the middle are in the grid."""
        column_row = (xy - self.specs.grid.low_m[:2]) / self.specs.grid.cell_m
        return np.asarray(((column_row >= 0) & (column_row < self.specs.grid.cells)).all(1))

    def __call__(self, position: F64, intensity: F32, least_log_odds: float) -> Found:
        """The boxes around points and ModelErrors, as of `PillarNetwork`, with intensities (N,) from 0 to 1."""
        inputs, kinds = kit_pillars(position, intensity, self.specs), len(self.classes)
        boxes, log_odds = np.zeros((0, 8), np.float32), np.zeros((0, kinds), np.float32)
        if len(inputs[1]):
            boxes, log_odds = self._session.run(dict(zip(KIT_INPUTS, inputs, strict=True)), 1)
        shapes = (len(boxes), 8), (len(boxes), kinds)
        if (boxes.shape, log_odds.shape) != shapes or not (np.isfinite(boxes).all() and np.isfinite(log_odds).all()):
            raise ModelError(f"{self._path}: expected finite numbers (K, 8) and (K, {kinds}), found others")
        best = log_odds.argmax(1)
        highest = log_odds[np.arange(len(best)), best].astype(np.float64)
        kept = np.flatnonzero((highest >= least_log_odds) & (boxes[:, 3:6] > 0).all(1))
        numbers = boxes[kept].astype(np.float64)
        centers = numbers[:, :3] - np.array([0.0, 0.0, self.specs.ground_z_m])
        return Found(centers, numbers[:, 3:6], np.arctan2(*numbers[:, 6:].T), highest[kept], best[kept])
