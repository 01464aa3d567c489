"""Detections of single sensors, matches between them, and fused objects."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from pipeline.core.arrays import F32, F64, I32, I64, Rows, check_array, select_rows

__all__ = ["Boxes2D", "Boxes3D", "Detections", "Fused", "Matches"]


@dataclass(frozen=True, slots=True, eq=False)
class Boxes2D:
    """2D boxes in one image.

    Attributes:
        stamp_ns: Time of the image.
        frame_id: Camera optical frame.
        xyxy: (N, 4) float32, left, top, right, bottom in pixels; (0, 0) is the top left corner of the top left pixel.
        scores: (N,) float32 in [0, 1].
        class_ids: (N,) int32, row of the configured classes.
    """

    stamp_ns: int
    frame_id: str
    xyxy: F32
    scores: F32
    class_ids: I32

    def __post_init__(self) -> None:
        n = len(self.scores)
        check_array("xyxy", self.xyxy, (n, 4), np.float32)
        check_array("scores", self.scores, (n,), np.float32)
        check_array("class_ids", self.class_ids, (n,), np.int32)

    def __len__(self) -> int:
        return len(self.scores)

    def select(self, rows: Rows) -> "Boxes2D":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)

    @classmethod
    def empty(cls, stamp_ns: int, frame_id: str) -> Self:
        """No boxes."""
        return cls(stamp_ns, frame_id, np.zeros((0, 4), np.float32), np.zeros(0, np.float32), np.zeros(0, np.int32))


@dataclass(frozen=True, slots=True, eq=False)
class Boxes3D:
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
    """

    stamp_ns: int
    frame_id: str
    centers: F64
    sizes: F64
    yaws: F64
    scores: F32
    class_ids: I32
    point_counts: I32
    covariances: F64

    def __post_init__(self) -> None:
        n = len(self.scores)
        check_array("centers", self.centers, (n, 3), np.float64)
        check_array("sizes", self.sizes, (n, 3), np.float64)
        check_array("yaws", self.yaws, (n,), np.float64)
        check_array("scores", self.scores, (n,), np.float32)
        check_array("class_ids", self.class_ids, (n,), np.int32)
        check_array("point_counts", self.point_counts, (n,), np.int32)
        check_array("covariances", self.covariances, (n, 3, 3), np.float64)
        if n and not ((self.yaws > -np.pi) & (self.yaws <= np.pi)).all():
            raise ValueError("yaws: expected radians in (-pi, pi]")

    def __len__(self) -> int:
        return len(self.scores)

    def select(self, rows: Rows) -> "Boxes3D":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Pairs of a 3D box and a 2D box of one camera; each row at most once.

    Attributes:
        pairs: (M, 2) int64: row of the 3D boxes, row of the camera's 2D boxes; ordered by the former.
        iou: (M,) float32, overlap of the projected 3D box and the 2D box.
        projected_xyxy: (N, 4) float32, every 3D box in this image in pixels, clipped to it; NaN if not visible.
    """

    pairs: I64
    iou: F32
    projected_xyxy: F32

    def __post_init__(self) -> None:
        check_array("pairs", self.pairs, (len(self.iou), 2), np.int64)
        check_array("iou", self.iou, (len(self.iou),), np.float32)
        check_array("projected_xyxy", self.projected_xyxy, (len(self.projected_xyxy), 4), np.float32)

    def __len__(self) -> int:
        return len(self.iou)


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Detections of one frame, before fusion.

    Attributes:
        lidar: 3D boxes from the combined cloud, in the site frame.
        cameras: 2D boxes by camera name.
    """

    lidar: Boxes3D
    cameras: Mapping[str, Boxes2D]


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """The fused objects of a frame.

    Attributes:
        objects: The fused objects, in the order of the 3D boxes.
        matched: (N,) int32, number of cameras that matched each object.
        lidar_rows: (N,) int64, row of `Detections.lidar` that each object comes from.
    """

    objects: Boxes3D
    matched: I32
    lidar_rows: I64

    def __post_init__(self) -> None:
        check_array("matched", self.matched, (len(self.objects),), np.int32)
        check_array("lidar_rows", self.lidar_rows, (len(self.objects),), np.int64)
