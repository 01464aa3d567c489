"""Records of evaluation: the results of a frame beside the truth about it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import getitem
from typing import Any, ClassVar, Protocol, Self, TypeAlias, Union

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, Bools, CheckedTable, Names, Table
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D

UNKNOWN = -1
"""Stands for a class, an id or a count that is not known."""

SOURCES = ("lidar", "cameras", "fused")
"""Sources of 3D boxes in the order of the figures: a source that is made of others comes last."""

Figure: TypeAlias = float | int | str | bool | None
"""None: the figure is not defined, as a precision is without detections."""

Figures: TypeAlias = Mapping[str, Union["Figures", Sequence["Figures"], Figure]]
"""A tree of figures by name, as JSON has it; the names are lower case, joined by underscores."""


def figure_at(tree: Any, name: str) -> Any:
    """The figure of a dotted name in a tree of figures."""
    return reduce(getitem, name.split("."), tree)


@dataclass(frozen=True, slots=True, eq=False)
class TruthBoxes3D(CheckedTable):
    """True objects at one moment."""

    ROWS: ClassVar = {"centers": (3,), "sizes": (3,)}

    stamp_ns: int  # The moment
    frame_id: str  # Frame of `centers`
    centers: F64  # (N, 3) float64, centre of the box, metres
    sizes: F64  # (N, 3) float64, length, width, height, metres
    yaws: F64  # (N,) float64, about +z, in (-pi, pi]
    class_ids: I32  # (N,) int32, row of the configured classes; `UNKNOWN` for an object of no configured class
    # (N,) str, the objects' classes as the truth names them (`van`, where the configured class is `truck`)
    labels: Names
    track_ids: I64  # (N,) int64, the same for the same object in all frames; `UNKNOWN` if the truth has none
    lidar_points: I32  # (N,) int32, lidar points on it; `UNKNOWN` if the truth does not say
    image_pixels: I32  # (N,) int32, pixels that show it, in all images; `UNKNOWN` if the truth does not say
    is_ignored: Bools  # (N,) bool, neither a miss nor an error, whatever the results say about it


@dataclass(frozen=True, slots=True, eq=False)
class TruthBoxes2D(CheckedTable):
    """True objects in one image."""

    ROWS: ClassVar = {"xyxy": (4,)}

    stamp_ns: int  # Time of the image
    xyxy: F32  # (N, 4) float32, left, top, right, bottom of what the image shows of each object, pixels
    class_ids: I32  # (N,) int32, row of the configured classes; `UNKNOWN` for an object of no configured class
    labels: Names  # (N,) str, the objects' classes as the truth names them
    track_ids: I64  # (N,) int64, as in `TruthBoxes3D`
    image_pixels: I32  # (N,) int32, pixels of this image that show it; `UNKNOWN` if the truth does not say
    is_ignored: Bools  # (N,) bool, neither a miss nor an error; regions that nobody labelled are such rows, too


@dataclass(frozen=True, slots=True, eq=False)
class Motion(CheckedTable):
    """Motion of N tracked objects."""

    ROWS: ClassVar = {"velocities": (2,)}

    velocities: F64  # (N, 2) float64, over the ground, along x and y of the site frame, m/s; NaN where it is not known
    yaw_rates: F64  # (N,) float64, over the ground, rad/s, counter-clockwise; NaN where it is not known
    is_predicted: Bools  # (N,) bool, whether nothing of the object was seen in this frame
    moving: Bools  # (N,) bool, of `Tracks`

    @classmethod
    def unknown(cls, count: int) -> Self:
        """Objects whose motion is not known."""
        return cls(np.full((count, 2), np.nan), np.full(count, np.nan), *np.zeros((2, count), np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class SourceBoxes(Table):
    """The objects of one source in a frame."""

    boxes: Boxes3D  # Its objects
    track_ids: I64  # (N,) int64, the same for the same object in all frames; `UNKNOWN` where the result has none
    motion: Motion | None = None  # Their motion; None if the source says nothing of it
    # (N,) whether each is neither right nor wrong, as in a zone where nothing is reported; None if none is
    is_ignored: Bools | None = None

    def __post_init__(self) -> None:
        self.check_rows()
        if self.motion is not None and len(self.motion) != len(self):
            raise ValueError(f"motion: expected that of {len(self)} objects, got {len(self.motion)}")


@dataclass(frozen=True, slots=True, eq=False)
class ImageBoxes:
    """The 2D boxes found in one image, and the true ones."""

    found: Boxes2D  # The 2D boxes of the camera
    truth: TruthBoxes2D | None = None  # The true boxes; None if they are not known


@dataclass(frozen=True, slots=True)
class FrameSync:
    """The messages that a frame of a result was made of."""

    log_time_ns: int  # Log time of the frame
    offsets_ns: Mapping[str, int]  # Stamp of the message of each topic, minus that of the frame
    missing: Mapping[str, str]  # Why there is no message, by the name of each sensor without one


@dataclass(frozen=True, slots=True, eq=False)
class ResultFrame:
    """One frame of a result."""

    index: int  # Its number, from 0
    stamp_ns: int  # Its time
    log_time_ns: int  # Log time of its messages
    # 3D boxes by source, empty where nothing was found; a source without an entry has no message
    sources: Mapping[str, SourceBoxes]
    # 2D boxes by camera, with the stamp of the image; only cameras with an image or boxes in this frame
    cameras: Mapping[str, Boxes2D]
    # Largest minus smallest stamp of the messages that the frame was made of; None if not known
    skew_ns: int | None = None
    sync: FrameSync | None = None  # These messages; None if not known


@dataclass(frozen=True, slots=True, eq=False)
class EvaluationFrame:
    """One frame of a result, with the truth at its time and in its frame of reference."""

    index: int  # Number of the frame, from 0
    stamp_ns: int  # Its time
    # The objects at that time, in the frame of the results; None if the truth does not cover the time
    truth: TruthBoxes3D | None
    # The objects found, by source: `lidar`, `fused`, and `cameras` where cameras alone place objects
    sources: Mapping[str, SourceBoxes]
    # By camera name; only cameras with an image or boxes in this frame
    images: Mapping[str, ImageBoxes] = field(default_factory=dict)
    # Largest minus smallest stamp of the messages that the frame is made of; None if not known
    skew_ns: int | None = None
    # (4, 4) float64, where the site frame stands on the ground, in a frame that does not move; None if it is not known
    T_fixed_site: F64 | None = field(default_factory=lambda: np.eye(4))
    sync: FrameSync | None = None  # The messages that it was made of; None if that is not known


def in_order(sources: Iterable[str]) -> list[str]:
    """Names of sources in the order of `SOURCES`; others follow by name."""
    return sorted(sources, key=lambda name: (SOURCES.index(name) if name in SOURCES else len(SOURCES), name))


class Evaluator(Protocol):
    """Measures the frames of a result, which come in order."""

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame."""

    def figures(self) -> Figures:
        """The figures of all frames."""
