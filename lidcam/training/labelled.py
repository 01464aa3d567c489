"""Labelled frames: points with their true objects, varied, and with objects from other frames in free places.

Places are relative to the middle of the lidars and heights are above the ground, in metres, as in `PillarPoints`.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, U8, Bools, Rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.polygons import first_polygon_with
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.parallel.transfer import dump, load

NAMES = ("car", "pedestrian", "cyclist", "truck", "bus")
"""Classes of labelled frames. A van counts as a truck, as it does among the classes of lidcam."""

WORLDS, RECORDINGS = "drawn worlds", "recordings"
"""Names of the sources in cards."""

MAX_PASTED = 8  # Objects put into a frame at most, as their places are free
MIN_PASTED_POINTS = 10  # Points on an object that is put into other frames
FREE_M = 0.3  # Distance of an object put into a frame from points and other boxes
MARGIN_M = 0.1  # Maximum distance of an object's points from its box

FIRST_HELD_OUT = 1_000_000  # Plus the seed: number of the first world that calibrates or judges a network

Progress = Callable[[float, str], object]
"""Called with the share that is done, and a text to show with it."""


class TrueBoxes(NamedTuple):
    """M objects: centres (M, 3), sizes (M, 3), yaws, rows of the classes that are learned, and numbers of points."""

    centers: F64
    sizes: F64
    yaws: F64
    classes: I64
    points: I64

    def select(self, rows: Rows) -> "TrueBoxes":
        """The objects of some rows."""
        return TrueBoxes._make(part[rows] for part in self)

    @staticmethod
    def joined(parts: Sequence["TrueBoxes"]) -> "TrueBoxes":
        """All objects of all parts; at least one part is needed."""
        return TrueBoxes._make(np.concatenate(one) for one in zip(*parts, strict=True))


def varied(
    position: F64, true: TrueBoxes, draw: np.random.Generator, turn_rad: float = np.pi / 4
) -> tuple[F64, TrueBoxes, F64]:
    """Mirror, turn about the middle and stretch a frame, and lift it as if the ground was found a little wrong.

    Returns (N, 3) points, the objects, and the matrix (3, 3) that changed both; heights are also lifted.
    """
    mirror, angle = np.array([1.0, draw.choice([-1.0, 1.0]), 1.0]), draw.uniform(-turn_rad, turn_rad)
    size, lift_m = draw.uniform(0.93, 1.07), draw.normal(0, 0.01) * position[:, 2].max(initial=0.0)
    change = size * _turn(angle) * mirror
    lift = np.array([0, 0, lift_m])
    yaws = mirror[1] * true.yaws + angle
    moved = true._replace(centers=true.centers @ change.T + lift, sizes=size * true.sizes, yaws=yaws)
    return position @ change.T + lift, moved, change


def _turn(angle: float) -> F64:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def points_in_boxes(position: F64, true: TrueBoxes) -> tuple[I64, I64]:
    """Rows of the points (N, 3) in boxes or just outside them, and the box of each; sorted by box."""
    xyz = position.astype(np.float32)
    rows, box = points_in_footprints(xyz, true.centers[:, :2], true.sizes[:, :2] + 2 * MARGIN_M, true.yaws)
    away_m = np.abs(position[rows, 2] - true.centers[box, 2])
    near = away_m <= true.sizes[box, 2] / 2 + MARGIN_M
    return rows[near], box[near]


class Objects(NamedTuple):
    """Boxes with the points (K, 3) of each and their lidars (K,), to put into other frames."""

    true: TrueBoxes
    position: list[F32]
    lidar: list[U8]


class LabelledFrame(NamedTuple):
    """The points of a frame that are not ground, and the true objects."""

    position: F64  # (N, 3) points
    lidar: U8  # (N,) row of `origins` that measured each point
    origins: F64  # (L, 3) places of the lidars
    true: TrueBoxes  # Objects that count; `classes` are rows of `NAMES`
    unlabelled: F64  # (U, 3) x, y and radius of circles around objects that do not count
    region: F64  # (C, 2) corners of the labelled region
    reach: F64  # (3,) x, y and radius of a circle that also limits it

    def is_labelled(self, xy: F64) -> Bools:
        """(K,) whether places (K, 2) are labelled, be it as objects or as free."""
        within = first_polygon_with([self.region], xy) == 0
        within &= np.linalg.norm(xy - self.reach[:2], axis=1) <= self.reach[2]
        away_m = np.linalg.norm(xy[:, None] - self.unlabelled[:, :2], axis=2)
        return np.asarray(within & (away_m > self.unlabelled[:, 2]).all(1))

    def with_objects(self, objects: Objects, draw: np.random.Generator) -> "LabelledFrame":
        """The frame with more objects, of random classes, in free places at their old distance from the middle.

        After Yan, Mao, Li, "SECOND: Sparsely embedded convolutional detection", Sensors 2018.
        """
        frame, classes = self, np.unique(objects.true.classes)
        for _ in range(MAX_PASTED if len(classes) else 0):
            row = draw.choice(np.flatnonzero(objects.true.classes == draw.choice(classes)))
            angle = draw.uniform(-np.pi, np.pi)
            turn = _turn(angle)
            one = objects.true.select(np.array([row]))
            one = one._replace(centers=one.centers @ turn.T, yaws=wrap_angle(one.yaws + angle))
            if frame.is_labelled(one.centers[:, :2])[0] and frame._is_free(one):
                lidar = np.minimum(objects.lidar[row], len(frame.origins) - 1)
                frame = frame._replace(
                    position=np.concatenate([frame.position, objects.position[row] @ turn.T]),
                    lidar=np.append(frame.lidar, lidar).astype(np.uint8),
                    true=TrueBoxes.joined([frame.true, one]),
                )
        return frame

    def _is_free(self, one: TrueBoxes) -> bool:
        margin = one._replace(sizes=one.sizes + 2 * FREE_M)
        radius_m = np.hypot(*margin.sizes[0, :2]) / 2 + np.linalg.norm(self.true.sizes[:, :2], axis=1) / 2
        away_m = np.linalg.norm(self.true.centers[:, :2] - one.centers[:, :2], axis=1)
        return bool((away_m > radius_m).all()) and not len(points_in_boxes(self.position, margin)[0])

    def varied(self, draw: np.random.Generator) -> "LabelledFrame":
        """The frame mirrored, turned by any angle, stretched and lifted."""
        position, true, change = varied(self.position, self.true, draw, np.pi)
        ground, size = change[:2, :2], change[2, 2]
        circles = np.vstack([self.unlabelled, self.reach])
        circles = np.column_stack([circles[:, :2] @ ground.T, size * circles[:, 2]])
        origins, region = self.origins @ change.T, self.region @ ground.T
        return LabelledFrame(position, self.lidar, origins, true, circles[:-1], region, circles[-1])


class Recordings(NamedTuple):
    """The labelled frames of recordings, in temporary files of this run."""

    train: tuple[Path, ...]  # Frames to learn from
    calibrate: tuple[Path, ...]  # Frames that turn scores into probabilities
    judge: tuple[Path, ...]  # Frames that give the figures
    objects: Path  # File of the objects in `train`
    names: tuple[str, ...]  # Files of the recordings, with checksums

    @property
    def text(self) -> str:
        """The recordings and their numbers of frames, in Markdown."""
        counts = f"{len(self.train)} frames; {len(self.calibrate)} and {len(self.judge)} kept apart"
        return "\n  ".join(("recordings", *self.names, f"({counts})"))

    def drawn(self, draw: np.random.Generator) -> LabelledFrame:
        """A random frame to learn from, with more objects in it, varied."""
        frame: LabelledFrame = loaded(self.train[draw.integers(len(self.train))])
        return frame.with_objects(loaded(self.objects), draw).varied(draw)


def saved(path: Path, value: object) -> Path:
    """Write a frame, or another object of this run, to a new file."""
    with path.open("xb", buffering=0) as file:
        dump(value, file)
    return path


@lru_cache(32)
def loaded(path: Path) -> Any:
    """The content of such a file; the last ones stay in memory."""
    with path.open("rb", buffering=0) as file:
        return load(file)
