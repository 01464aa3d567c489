"""What both kits have in common, and which of their parts lidcam runs."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.detectors.pillars.kits import Feature, KitGrid, KitSpecs
from lidcam.pipeline.detectors.pillars.network import FoundClass

OFFSETS: list[Feature] = ["dx_mean", "dy_mean", "dz_mean", "dx_cell", "dy_cell", "dz_cell"]
KNOWN: list[Feature] = ["x", "y", "z", "intensity"]

SPARSE = "Sparse", "BackBone8x", "UNet"
"""Texts in the names of parts with sparse convolutions, which onnxruntime lacks."""


class Data(NamedTuple):
    """What a network was trained with.

    Attributes:
        ground_z_m: Height of the ground from the lidar; None: unknown.
        intensity_max: The highest intensity; None: unknown.
    """

    ground_z_m: float | None
    intensity_max: float | None


DATA_SETS = {"KittiDataset": Data(-1.73, 1), "NuScenesDataset": Data(-1.84, 255), "WaymoDataset": Data(0, 1)}
"""By the names of both kits. KITTI and nuScenes state the height of their lidar; Waymo's frame lies on the ground."""


def check(found: object, expected: object, what: str) -> None:
    """Refuse a value that lidcam does not run.

    Raises:
        ModelError: another value was found.
    """
    if found != expected:
        raise ModelError(f"{what}: expected {expected}, which lidcam runs, found {found}")


def check_parts(name: str, parts: Mapping[str, str], known: Mapping[str, Sequence[str]]) -> None:
    """Refuse networks that have other parts.

    Args:
        name: Name of the network.
        parts: The kinds of its parts, by purpose.
        known: The kinds that lidcam runs.

    Raises:
        ModelError: a part is of another kind, or missing.
    """
    strange = [
        f"{part} {kind}" + " (sparse convolutions)" * any(word in kind for word in SPARSE)
        for part, kind in parts.items()
        if kind not in known.get(part, ())
    ]
    strange += [f"no {part}" for part in known if part not in parts]
    if strange:
        raise ModelError(f"expected PointPillars or CenterPoint in pillars, found {name} with {', '.join(strange)}")


def raw_features(names: Iterable[str]) -> list[Feature]:
    """The features of each point by itself."""
    return [next((one for one in KNOWN if one == name), "zero") for name in names]


def specs_of(
    classes: Sequence[str],
    limits: Sequence[float],
    cell: Sequence[float],
    features: list[Feature],
    max_points: int,
    data: Data,
) -> KitSpecs:
    """The record for a file of a network.

    Args:
        classes: Names of its classes.
        limits: Lowest x, y, z and highest x, y, z of its points.
        cell: Sides of a pillar, and its height.
        features: Features of its points.
        max_points: Points in a pillar.
        data: What it was trained with.

    Raises:
        ModelError: the height of the ground is unknown, or there is more than one layer of cells.
    """
    low, high = limits[:3], limits[3:]
    columns, rows, layers = (round((end - start) / side) for start, end, side in zip(low, high, cell, strict=True))
    check(layers, 1, "layers of voxels")
    if data.ground_z_m is None or data.intensity_max is None:
        sets = ", ".join(DATA_SETS)
        raise ModelError(f"expected --ground-z and --intensity-max, as its data set is none of {sets}")
    grid = KitGrid(low_m=low, high_z_m=high[2], cell_m=cell[:2], cells=(columns, rows))
    named = tuple(FoundClass(name=name) for name in classes)
    return KitSpecs(
        classes=named,
        layout="points",
        features=features,
        max_points=max_points,
        grid=grid,
        ground_z_m=data.ground_z_m,
        intensity_max=data.intensity_max,
    )


def data_of(name: Any, given: Data) -> Data:
    """The values given, or else those known for the data set."""
    known = DATA_SETS.get(name, Data(None, None))
    return Data(*(of_set if one is None else one for one, of_set in zip(given, known, strict=True)))
