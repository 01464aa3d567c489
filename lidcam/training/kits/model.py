"""A kit's network in terms that both kits share, and which of their parts lidcam runs."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.model import Positive, SettingsModel
from lidcam.pipeline.detectors.pillars.kits import Feature, KitGrid, KitSpecs
from lidcam.pipeline.detectors.pillars.network import FoundClass

OFFSETS: list[Feature] = ["dx_mean", "dy_mean", "dz_mean", "dx_cell", "dy_cell", "dz_cell"]
POINT_FEATURES: list[Feature] = ["x", "y", "z", "intensity"]

SPARSE = "Sparse", "BackBone8x", "UNet"  # In the names of parts with sparse convolutions, which onnxruntime lacks


class Data(NamedTuple):
    """Ground height from the lidar, metres, and highest intensity of a data set; None: unknown."""

    ground_z_m: float | None
    intensity_max: float | None


DATA_SETS = {"KittiDataset": Data(-1.73, 1), "NuScenesDataset": Data(-1.84, 255), "WaymoDataset": Data(0, 1)}
"""By the names of both kits. KITTI and nuScenes state the height of their lidar; Waymo's frame lies on the ground."""


class Names(NamedTuple):
    """Names of layers in a kit: prefixes of its parts, and single layers or branches of its heads.

    `first` is the place of the first convolution in a block, `pair` a convolution and the normalisation after it;
    `branches` are those for places, heights, sizes and headings.
    """

    encoder: str
    blocks: str
    ups: str
    head: str
    first: int
    boxes: str
    heads: str
    pair: tuple[str, str]
    heat: str
    branches: tuple[str, str, str, str]


class Encoder(SettingsModel):
    """Layers over the points of a pillar; after each but the last, the pillar's maximum is added to each point."""

    channels: tuple[int, ...]
    eps: Positive = 1e-3


class Backbone(SettingsModel):
    """Convolutions over the ground: for each block the first one has a stride, and `layers` follow it.

    The output of each block is scaled by `up_strides`; below 1 it becomes smaller, and a factor of 1 is a convolution
    if `convolves`, else a transposed one.
    """

    channels: tuple[int, ...]
    layers: tuple[int, ...]
    strides: tuple[int, ...]
    up_channels: tuple[int, ...]
    up_strides: tuple[Positive, ...]
    convolves: bool = False
    eps: Positive = 1e-3
    up_eps: Positive = 1e-3


class Anchor(SettingsModel):
    """A box in each cell of the output."""

    low_m: tuple[float, float]  # Place of the first box along x and y; with `is_centred`, the corner of its cell
    high_m: tuple[float, float]  # Place of the last box, or the corner of its cell
    is_centred: bool  # Whether boxes stand in the middle of their cells
    z_m: float  # Height of the middle of the box
    size_m: tuple[Positive, Positive, Positive]  # Length, width, height
    yaw_rad: float  # Heading


class AnchorHead(SettingsModel):
    """Boxes as differences from the anchors of each cell."""

    anchors: tuple[Anchor, ...]
    code: int = 7  # Numbers of a box
    directions: int  # Parts of a full turn that the network distinguishes; 0: none
    offset_rad: float  # Heading at which the first part begins
    limit: float  # Maximum distance of a heading before that, in parts


class CenterHead(SettingsModel):
    """Boxes at the peaks of classes."""

    tasks: tuple[tuple[str, ...], ...]  # Classes of each group
    shared: int  # Channels of the layer that all groups share
    width: int  # Channels of the branches
    kernel: int  # Kernel size of their convolutions
    heat_layers: int  # Number of convolutions in the branch for classes
    branches: dict[str, tuple[int, int]]  # Outputs and convolutions of the other branches, by name
    has_bias: bool  # Whether convolutions before a normalisation have a bias
    sine_first: bool  # Whether the sine of the heading comes before its cosine
    eps: Positive = 1e-5  # Epsilon of the normalisations
    stride: int  # Pillars along each side of a cell


class KitModel(NamedTuple):
    """A network, the names of its layers, and the metadata of its file."""

    names: Names
    specs: KitSpecs
    encoder: Encoder
    backbone: Backbone
    head: AnchorHead | CenterHead


def check(found: object, expected: object, name: str) -> None:
    """Refuse a value that lidcam does not run, by a ModelError."""
    if found != expected:
        raise ModelError(f"{name}: expected {expected}, which lidcam runs, found {found}")


def check_parts(network: str, parts: Mapping[str, str], known: Mapping[str, Sequence[str]]) -> None:
    """Raise ModelError if parts of a network, kinds by purpose, are missing or of other kinds than the known ones."""
    faults = [
        f"{part} {kind}" + " (sparse convolutions)" * any(word in kind for word in SPARSE)
        for part, kind in parts.items()
        if kind not in known.get(part, ())
    ]
    faults += [f"no {part}" for part in known if part not in parts]
    if faults:
        raise ModelError(f"expected PointPillars or CenterPoint in pillars, found {network} with {', '.join(faults)}")


def raw_features(names: Iterable[str]) -> list[Feature]:
    """The features of each point by itself."""
    return [next((one for one in POINT_FEATURES if one == name), "zero") for name in names]


def specs_of(
    classes: Sequence[str],
    head: AnchorHead | CenterHead,
    limits: Sequence[float],
    cell: Sequence[float],
    features: list[Feature],
    max_points: int,
    data_set: Any,
    given: Data,
) -> KitSpecs:
    """Metadata for the file of a network. A head with groups of classes says their names itself.

    `limits` are the lowest x, y, z and the highest x, y, z of its points, `cell` the sides of a pillar and its height,
    `max_points` the points in a pillar. Values that are `given` take precedence over those known for the data set.
    Raises ModelError if the height of the ground is unknown, or there is more than one layer of cells.
    """
    classes = [name for task in head.tasks for name in task] if isinstance(head, CenterHead) else classes
    low, high = limits[:3], limits[3:]
    columns, rows, layers = (round((end - start) / side) for start, end, side in zip(low, high, cell, strict=True))
    check(layers, 1, "layers of voxels")
    known = DATA_SETS.get(data_set, Data(None, None))
    ground_z_m, intensity_max = (one if own is None else own for own, one in zip(given, known, strict=True))
    if ground_z_m is None or intensity_max is None:
        sets = ", ".join(DATA_SETS)
        raise ModelError(f"expected --ground-z and --intensity-max, as its data set is none of {sets}")
    return KitSpecs(
        classes=tuple(FoundClass(name=name) for name in classes),
        features=features,
        max_points=max_points,
        grid=KitGrid(low_m=low, high_z_m=high[2], cell_m=cell[:2], cells=(columns, rows)),
        ground_z_m=ground_z_m,
        intensity_max=intensity_max,
    )
