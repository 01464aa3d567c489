"""Point clouds of one lidar, and of all lidars combined."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F32, F64, I32, U8, U16, Table, check_array
from lidcam.pipeline.core.text import brief


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud(Table):
    """Points of one sweep, or of several sweeps in one frame.

    Attributes:
        stamp_ns: Origin of `time_offset_ns`.
        frame_id: Frame of `xyz`.
        xyz: (N, 3) float32, metres; all finite.
        intensity: (N,) float32 in the sensor's own scale, all finite; zeros where the sensor reports none.
        ring: (N,) uint16 laser index; zeros where the sensor reports none.
        time_offset_ns: (N,) int32, time of each point minus `stamp_ns`; zeros where the sensor reports none.
        has_time: Whether `time_offset_ns` was measured.
        nan_dropped: Number of points removed because a coordinate was NaN or out of range.
        return_type: (N,) uint8, echo of its beam that each point is: 1 strongest, 2 last, 3 both, 0 unknown; None if
            the driver does not report it.
    """

    ROWS: ClassVar = {"xyz": (3,)}

    stamp_ns: int
    frame_id: str
    xyz: F32
    intensity: F32
    ring: U16
    time_offset_ns: I32
    has_time: bool = False
    nan_dropped: int = 0
    return_type: U8 | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        self.check_rows()
        if self.return_type is not None:
            check_array("return_type", self.return_type, (len(self),), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane in the site frame, normal . p + offset_m = 0."""

    normal: F64  # (3,) float64 unit vector; points up (z > 0)
    offset_m: float  # Signed distance of the origin from the plane

    def __post_init__(self) -> None:
        check_array("normal", self.normal, (3,), np.float64)

    def height_m(self, xy: npt.NDArray[np.floating[Any]]) -> F64:
        """Z of the plane at points `xy` (..., 2)."""
        return np.asarray(-(xy @ self.normal[:2] + self.offset_m) / self.normal[2], np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """How the ground differs from its plane, on a grid over x and y."""

    origin_xy: F64  # (2,) float64, place of the first node in the site frame, metres
    cell_m: float  # Distance between nodes
    offsets_m: F64  # (H, W) float64, height of the ground above the plane at node (row along y, column along x)

    __repr__ = brief

    def __post_init__(self) -> None:
        check_array("origin_xy", self.origin_xy, (2,), np.float64)
        height, width = self.offsets_m.shape
        if height < 2 or width < 2:
            raise ValueError(f"offsets_m: expected 2 x 2 nodes or more, got {height} x {width}")
        check_array("offsets_m", self.offsets_m, (height, width), np.float64)

    def offset_m(self, xy: npt.NDArray[np.floating[Any]]) -> F64:
        """Height of the ground above the plane at points `xy` (..., 2); bilinear, beyond the grid that of its edge."""
        height, width = self.offsets_m.shape
        last = np.array([width - 1, height - 1])
        place = np.minimum(np.maximum((np.asarray(xy, np.float64) - self.origin_xy) / self.cell_m, 0.0), last)
        node = np.minimum(place.astype(np.int64), last - 1)
        share = place - node
        x, y, first = share[..., 0], share[..., 1], node[..., 1] * width + node[..., 0]
        a, b, c, d = self.offsets_m.ravel().take(np.add.outer([0, 1, width, width + 1], first))
        left = 1 - x
        return np.asarray((a * left + b * x) * (1 - y) + (c * left + d * x) * y)


@dataclass(frozen=True, slots=True, eq=False)
class CombinedCloud:
    """The points of all lidars in the site frame at the frame's time.

    Attributes:
        cloud: The points without outliers and ground, if these steps are on; what is written and shown.
        detection_cloud: Points to detect objects in: without ground and rain, but with other outliers.
        detection_lidar_index: (M,) uint8, row of `Rig.lidars` that measured each of these.
        ground_cloud: The points of the ground.
        plane: The ground; None if that step is off or found none.
        counts: Number of points: `input`, removed as `nan`, by `range`, as `outliers`, as `ground`, and `left`.
        compensated: Names of the lidars whose points were motion-compensated to the frame's time.
        points_by_lidar: Number of points within range, by name of the lidar; of those with a message in the frame.
        relief: How the ground differs from the plane; None if that is not sought, or there is no plane.
        ground_lidar_index: (G,) uint8, row of `Rig.lidars` that measured each point of the ground; None where unknown.
    """

    cloud: PointCloud
    detection_cloud: PointCloud
    detection_lidar_index: U8
    ground_cloud: PointCloud
    plane: Plane | None
    counts: Mapping[str, int]
    compensated: tuple[str, ...] = ()
    points_by_lidar: Mapping[str, int] = field(default_factory=dict)
    relief: Relief | None = None
    ground_lidar_index: U8 | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        check_array("detection_lidar_index", self.detection_lidar_index, (len(self.detection_cloud),), np.uint8)

    def ground_m(self, xy: npt.NDArray[np.floating[Any]], *, level_m: float) -> F64:
        """Z of the ground at points `xy` (..., 2) of the site frame: of the plane and its relief, else `level_m`."""
        if self.plane is None:
            return np.full(xy.shape[:-1], level_m)
        height_m = self.plane.height_m(xy)
        return height_m if self.relief is None else height_m + self.relief.offset_m(xy)
