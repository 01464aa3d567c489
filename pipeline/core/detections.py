"""Detections of single sensors, matches between them, and fused objects."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar, Self

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, U8, CheckedTable, Table, check_array, join_rows
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.core.tracks import Tracks

NO_HYPOTHESIS = -1
"""Hypothesis row of an object that nothing in its frame shows."""


class Source(IntEnum):
    """The source of a 3D box's geometry. Arrays take the values: numpy is slow with members."""

    LIDAR = 0
    """Points, or boxes of a lidar detector; no camera took part."""
    CAMERA = 1
    """2D boxes alone: placed by the ground and the size of the class."""
    BOTH = 2
    """Points and 2D boxes."""
    PREDICTED = 3
    """Nothing in this frame: where its track says that it is."""


_SOURCE_NAMES = {source.value: source.name.lower() for source in Source}


def source_names(sources: U8) -> list[str]:
    """`lidar`, `camera`, `both` or `predicted` for each `Source` of an array (N,)."""
    return [_SOURCE_NAMES[source] for source in sources.tolist()]


@dataclass(frozen=True, slots=True, eq=False)
class Boxes2D(CheckedTable):
    """2D boxes in one image.

    Attributes:
        stamp_ns: Time of the image.
        frame_id: Camera optical frame.
        xyxy: (N, 4) float32, left, top, right, bottom in pixels; (0, 0) is the top left corner of the top left pixel.
        scores: (N,) float32 in [0, 1].
        class_ids: (N,) int32, row of the configured classes.
    """

    ROWS: ClassVar = {"xyxy": (4,)}

    stamp_ns: int
    frame_id: str
    xyxy: F32
    scores: F32
    class_ids: I32

    __repr__ = brief

    @classmethod
    def empty(cls, stamp_ns: int, frame_id: str) -> Self:
        """No boxes."""
        return cls.zeros(stamp_ns=stamp_ns, frame_id=frame_id)


@dataclass(frozen=True, slots=True, eq=False)
class Boxes3D(Table):
    """Oriented boxes of one frame.

    Attributes:
        stamp_ns: The frame's time.
        frame_id: Frame of `centers` (the site frame).
        centers: (N, 3) float64, centre of the box (not of its bottom), metres.
        sizes: (N, 3) float64, length, width, height along the box's own x, y, z, metres.
        yaws: (N,) float64, counter-clockwise about +z, in (-pi, pi].
        scores: (N,) float32 in [0, 1].
        class_ids: (N,) int32, row of the configured classes.
        point_counts: (N,) int32, lidar points that the box was found from; zeros where unknown.
        covariances: (N, 3, 3) float64 over x, y (m^2) and yaw (rad^2); zeros where unknown.
        sources: (N,) uint8, the `Source` of each box.
        measured_ns: (N,) int64, when the object was where its box says: mean time of its points or images; of tracked
            objects `stamp_ns`.
    """

    ROWS: ClassVar = {"centers": (3,), "sizes": (3,), "covariances": (3, 3)}

    stamp_ns: int
    frame_id: str
    centers: F64
    sizes: F64
    yaws: F64
    scores: F32
    class_ids: I32
    point_counts: I32
    covariances: F64
    sources: U8
    measured_ns: I64

    __repr__ = brief

    def __post_init__(self) -> None:
        self.check_rows()
        if len(self) and not ((self.yaws > -np.pi) & (self.yaws <= np.pi)).all():
            raise ValueError("yaws: expected radians in (-pi, pi]")

    def joined(self, *others: "Boxes3D") -> "Boxes3D":
        """These boxes and then the others, which are of the same moment and frame."""
        return join_rows(self, *others)

    @classmethod
    def empty(cls, stamp_ns: int, frame_id: str) -> Self:
        """No boxes."""
        return cls.zeros(stamp_ns=stamp_ns, frame_id=frame_id)


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Pairs of a 3D box and a 2D box of one camera; each row at most once.

    Overlaps and projections are those of the boxes when they were matched; later stages may change the boxes.

    Attributes:
        pairs: (M, 2) int64: row of the 3D boxes, row of the camera's 2D boxes; ordered by the former.
        iou: (M,) float32, overlap of the projected 3D box and the 2D box.
        projected_xyxy: (N, 4) float32, every 3D box in this image in pixels, clipped to it; NaN if not visible.
        hidden: (N,) float32 in [0, 1], share of that rectangle that nearer 3D boxes cover; 0 where not visible.
        edge_depths_px: (N, 4) float32, how deep a nearer 3D box covers its left, top, right and bottom edge; 0 for free
            edges.
    """

    pairs: I64
    iou: F32
    projected_xyxy: F32
    hidden: F32
    edge_depths_px: F32

    __repr__ = brief

    def __post_init__(self) -> None:
        check_array("pairs", self.pairs, (len(self.iou), 2), np.int64)
        check_array("iou", self.iou, (len(self.iou),), np.float32)
        check_array("projected_xyxy", self.projected_xyxy, (len(self.projected_xyxy), 4), np.float32)
        check_array("hidden", self.hidden, (len(self.projected_xyxy),), np.float32)
        check_array("edge_depths_px", self.edge_depths_px, (len(self.projected_xyxy), 4), np.float32)

    def __len__(self) -> int:
        return len(self.iou)


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """The detections of each sensor alone in one frame.

    Attributes:
        lidar: 3D boxes from the combined cloud, in the site frame.
        cameras: 2D boxes by camera name.
        placed: 3D boxes that the cameras alone place, in the site frame; None where no camera has 2D boxes.
    """

    lidar: Boxes3D
    cameras: Mapping[str, Boxes2D]
    placed: Boxes3D | None = None

    __repr__ = brief


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """The hypotheses of one frame, and the 2D boxes that are matched with them."""

    boxes: Boxes3D  # The boxes of `Detections.lidar` in their order, then those that 2D boxes propose
    # By camera name, for every camera of the rig; rows refer to `boxes` and to the camera's 2D boxes
    matches: Mapping[str, Matches]
    lidar_count: int  # Number of boxes of the lidars
    # Number of 2D boxes without a 3D box that begin no object, by reason
    boxes_without_object: Mapping[str, int] = field(default_factory=dict)

    __repr__ = brief

    @property
    def matched(self) -> I32:
        """(N,) number of cameras that matched each box."""
        rows = [matches.pairs[:, 0] for matches in self.matches.values()]
        return np.bincount(np.concatenate([np.zeros(0, np.int64), *rows]), minlength=len(self.boxes)).astype(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """The fused objects of a frame.

    Attributes:
        objects: The fused objects, in the order of the hypotheses, or of the numbers of their tracks.
        matched: (N,) int32, number of cameras that confirm each object: in this frame; of one with a track also with
            their last images of the second before.
        rows: (N,) int64, row of `Hypotheses.boxes` that each object comes from; `NO_HYPOTHESIS` if it is predicted.
        left_out: Number of other objects by the reason why they are not reported.
        tracks: The tracks of the objects, in their order; None where nothing is tracked.
    """

    objects: Boxes3D
    matched: I32
    rows: I64
    left_out: Mapping[str, int] = field(default_factory=dict)
    tracks: Tracks | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        check_array("matched", self.matched, (len(self.objects),), np.int32)
        check_array("rows", self.rows, (len(self.objects),), np.int64)
        if self.tracks is not None and len(self.tracks) != len(self.objects):
            raise ValueError(f"tracks: expected {len(self.objects)}, one of each object, got {len(self.tracks)}")
