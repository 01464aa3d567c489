"""The records that stages hand to one another: frozen dataclasses of parallel arrays, checked once, at birth.

Time is integer nanoseconds since the Unix epoch everywhere: `stamp_ns` is the sensor's time of measurement (message
header), `log_time_ns` the recorder's. Lengths are metres, angles radians, frames are named. Arrays become read-only,
so that a stage on another thread cannot change what its neighbour reads.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple, Self, TypeVar

import numpy as np
import numpy.typing as npt

from pipeline.core.camera import CameraModel
from pipeline.core.geometry import Transform

__all__ = [
    "Boxes2D",
    "Boxes3D",
    "CameraSensor",
    "Channel",
    "CombinedCloud",
    "Drop",
    "FrameResult",
    "Image",
    "LidarSensor",
    "Matches",
    "Plane",
    "PointCloud",
    "PoseSamples",
    "RawMessage",
    "Rig",
    "SensorBundle",
    "Zone",
]

Rows = npt.NDArray[np.bool_] | npt.NDArray[np.intp]
R = TypeVar("R", "PointCloud", "Boxes2D", "Boxes3D")


def check_array(name: str, array: npt.NDArray[Any], shape: tuple[int, ...], dtype: npt.DTypeLike) -> None:
    """Check one field of a record and make it read-only.

    Raises:
        ValueError: shape or dtype differ; the message says expected and found.
    """
    if array.shape != shape or array.dtype != np.dtype(dtype):
        raise ValueError(f"{name}: expected {np.dtype(dtype)}{list(shape)}, got {array.dtype}{list(array.shape)}")
    array.flags.writeable = False


# --- messages


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic of one recording file: what is needed to decode its messages.

    Attributes:
        topic: Topic name.
        msgtype: Type name in the ROS 2 spelling, for instance `sensor_msgs/msg/PointCloud2`.
        encoding: Serialisation of the bytes.
        definition: Message definition text as recorded, a protobuf FileDescriptorSet in base64; empty where the
            recording has none.
        definition_format: Says how to read `definition`.
        distro: Name of the ROS 2 release that the recording names, or empty.
        digest: What the recorder knew the type by: ROS 1's md5sum or a ROS 2 type hash (REP 2011); empty where the
            recording does not say.
    """

    topic: str
    msgtype: str
    encoding: Literal["ros1", "cdr", "protobuf", "json"]
    definition: str = ""
    definition_format: Literal["ros1msg", "ros2msg", "ros2idl", "protobuf", "jsonschema"] = "ros2msg"
    distro: str = ""
    digest: str = ""


class RawMessage(NamedTuple):
    """One recorded message, not decoded yet.

    Attributes:
        stamp_ns: Header stamp; `log_time_ns` where the type has no header.
        log_time_ns: Time of recording.
        order: (file index, position in the file), then the place within what was recorded as one message: makes the
            order of equal times total.
        data: The serialised message.
        channel: Topic, type and definition.
        problem: Why there are no data, where what was recorded cannot be read; empty if it can.
        left_out: Of a message that was made of several recorded ones: what was wrong with those that could not be used.
    """

    stamp_ns: int
    log_time_ns: int
    order: tuple[int, ...]
    data: bytes | memoryview
    channel: Channel
    problem: str = ""
    left_out: tuple[str, ...] = ()

    @property
    def topic(self) -> str:
        """Topic name."""
        return self.channel.topic


class Drop(NamedTuple):
    """One message that took no part, or parts of one of which the rest did, and why.

    Attributes:
        topic: Its topic.
        stamp_ns: Its stamp.
        reason: Why, in words that are the same for all messages with this fate.
        detail: What was found in this very message; may be empty.
        parts: How many of its parts took none, where the rest of it did; 0: the whole message.
    """

    topic: str
    stamp_ns: int
    reason: str
    detail: str = ""
    parts: int = 0


# --- sensor data


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of one sweep, or of several in one frame.

    Attributes:
        stamp_ns: Time that `time_offset_ns` counts from.
        frame_id: Frame of `xyz`.
        xyz: (N, 3) float32, metres; all finite.
        intensity: (N,) float32 in the sensor's own scale; zeros where the sensor reports none.
        ring: (N,) uint16 laser index; zeros where the sensor reports none.
        time_offset_ns: (N,) int32, time of each point minus `stamp_ns`; zeros where the sensor reports none.
        has_time: Whether `time_offset_ns` was measured.
        nan_dropped: Number of points that were left out because a coordinate was not finite.
        return_type: (N,) uint8, which echo of its beam each point is: 1 the strongest, 2 the last, 3 both, 0 not told;
            None where the sensor's driver says nothing of it.
    """

    stamp_ns: int
    frame_id: str
    xyz: npt.NDArray[np.float32]
    intensity: npt.NDArray[np.float32]
    ring: npt.NDArray[np.uint16]
    time_offset_ns: npt.NDArray[np.int32]
    has_time: bool = False
    nan_dropped: int = 0
    return_type: npt.NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        n = len(self.xyz)
        check_array("xyz", self.xyz, (n, 3), np.float32)
        check_array("intensity", self.intensity, (n,), np.float32)
        check_array("ring", self.ring, (n,), np.uint16)
        check_array("time_offset_ns", self.time_offset_ns, (n,), np.int32)
        if self.return_type is not None:
            check_array("return_type", self.return_type, (n,), np.uint8)

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, rows: Rows) -> "PointCloud":
        """The given rows (mask or indices), in that order."""
        return _select(self, rows)


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One picture.

    Attributes:
        stamp_ns: Time of exposure.
        frame_id: Camera optical frame.
        rgb: (H, W, 3) uint8, red first.
    """

    stamp_ns: int
    frame_id: str
    rgb: npt.NDArray[np.uint8]

    def __post_init__(self) -> None:
        check_array("rgb", self.rgb, (*self.rgb.shape[:2], 3), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class PoseSamples:
    """Poses of a moving frame around one moment, for motion compensation.

    Attributes:
        frame_id: The frame that moves (the site or vehicle frame).
        fixed_frame_id: The frame it moves in (`odom`, `map`).
        stamps_ns: (S,) int64, strictly increasing.
        T_fixed_moving: (S, 4, 4) float64, pose of the moving frame at each stamp.
    """

    frame_id: str
    fixed_frame_id: str
    stamps_ns: npt.NDArray[np.int64]
    T_fixed_moving: npt.NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        check_array("stamps_ns", self.stamps_ns, (n,), np.int64)
        check_array("T_fixed_moving", self.T_fixed_moving, (n, 4, 4), np.float64)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def covers(self, earliest_ns: int, latest_ns: int, *, max_extrapolation_s: float, max_gap_s: float) -> bool:
        """Whether the motion is known over a time span.

        It is where the span reaches no further than `max_extrapolation_s` beyond the first and the last pose, and no
        two poses that it lies between are further apart than `max_gap_s`. One pose tells no motion.
        """
        if len(self) < 2:
            return False
        reach_ns = round(max_extrapolation_s * 1e9)
        first = max(int(np.searchsorted(self.stamps_ns, earliest_ns, side="right")) - 1, 0)
        last = int(np.searchsorted(self.stamps_ns, latest_ns, side="left"))
        around_ns = self.stamps_ns[first : last + 1]
        ends_near = around_ns[0] - reach_ns <= earliest_ns and latest_ns <= around_ns[-1] + reach_ns
        return bool(ends_near and (np.diff(around_ns) <= round(max_gap_s * 1e9)).all())


@dataclass(frozen=True, slots=True, eq=False)
class SensorBundle:
    """Messages that belong to one moment, one per synchronised topic, still undecoded.

    Attributes:
        index: Running number of the frame, from 0.
        stamp_ns: Stamp of the reference topic's message: the frame's time.
        log_time_ns: Log time of that message.
        messages: By topic.
        motion: Poses of the site frame around `stamp_ns`, if the recording has odometry of it.
        left_out: How many messages were left out of every frame since the bundle before, by (topic, reason).
    """

    index: int
    stamp_ns: int
    log_time_ns: int
    messages: Mapping[str, RawMessage]
    motion: PoseSamples | None = None
    left_out: Mapping[tuple[str, str], int] = field(default_factory=dict)

    @property
    def skew_ns(self) -> int:
        """Largest minus smallest stamp of the set."""
        stamps = [message.stamp_ns for message in self.messages.values()]
        return max(stamps) - min(stamps)


# --- the rig


@dataclass(frozen=True, slots=True, eq=False)
class LidarSensor:
    """One lidar of the rig.

    Attributes:
        name: Short name, unique in the rig.
        topic: Topic of its clouds.
        T_site_lidar: Extrinsics; its `src` is the lidar's frame.
    """

    name: str
    topic: str
    T_site_lidar: Transform


@dataclass(frozen=True, slots=True, eq=False)
class CameraSensor:
    """One camera of the rig.

    Attributes:
        name: Short name, unique in the rig.
        topic: Topic of its images; empty where only its boxes were recorded.
        boxes_topic: Topic of recorded 2D boxes (vision_msgs/Detection2DArray); empty where there are none.
        model: Intrinsics.
        T_camera_site: Extrinsics; its `dst` is the camera's optical frame.
    """

    name: str
    topic: str
    boxes_topic: str
    model: CameraModel
    T_camera_site: Transform


@dataclass(frozen=True, slots=True, eq=False)
class Zone:
    """A part of the site that objects are counted in.

    Attributes:
        name: `intersection` and `circle` fill the fields of that name in MsgLidCam.
        polygon_site: (K, 2) float64, corners x, y in the site frame, metres.
    """

    name: str
    polygon_site: npt.NDArray[np.float64]

    def __post_init__(self) -> None:
        check_array("polygon_site", self.polygon_site, (len(self.polygon_site), 2), np.float64)


def default_zones() -> tuple[Zone, ...]:
    """The original's: `intersection` y >= 0 and `circle` y < 0; the edge between them belongs to the first."""
    far_m = 1e4  # further than any lidar sees, and finite
    return (
        Zone("intersection", np.array([[-far_m, 0.0], [far_m, 0.0], [far_m, far_m], [-far_m, far_m]])),
        Zone("circle", np.array([[-far_m, -far_m], [far_m, -far_m], [far_m, 0.0], [-far_m, 0.0]])),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """All sensors with sound calibration, in the order in which they are processed.

    Attributes:
        site_frame: The frame in which clouds are combined and objects are reported (x forward, y left, z up; REP 103).
        lidars: At least one.
        cameras: May be empty: the run is then lidar-only.
        zones: In order; an object belongs to the first zone that holds its centre.
        ground_height_m: Expected z of the ground plane below the site origin; None where unknown.
    """

    site_frame: str
    lidars: tuple[LidarSensor, ...]
    cameras: tuple[CameraSensor, ...]
    zones: tuple[Zone, ...]
    ground_height_m: float | None = None


# --- what stages find


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane in the site frame: the points with normal . p + offset_m = 0.

    Attributes:
        normal: (3,) float64 unit vector; points up (z > 0).
        offset_m: Signed distance of the origin from the plane.
    """

    normal: npt.NDArray[np.float64]
    offset_m: float

    def __post_init__(self) -> None:
        check_array("normal", self.normal, (3,), np.float64)

    def height_m(self, xy: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float64]:
        """Z of the plane at points `xy` (..., 2)."""
        return np.asarray(-(xy @ self.normal[:2] + self.offset_m) / self.normal[2], np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class CombinedCloud:
    """The points of all lidars in the site frame at the frame's time.

    Attributes:
        cloud: What is left to look for objects in: without outliers and ground, where these steps are on.
        lidar_index: (N,) uint8, row of `Rig.lidars` that measured the point.
        ground_cloud: The points of the ground.
        plane: The ground; None where that step is off or found none.
        counts: Number of points by step: `input`, `nan`, `range`, `outliers`, `ground`, `left`.
        compensated: Names of the lidars whose points were moved to the frame's time.
    """

    cloud: PointCloud
    lidar_index: npt.NDArray[np.uint8]
    ground_cloud: PointCloud
    plane: Plane | None
    counts: Mapping[str, int]
    compensated: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_array("lidar_index", self.lidar_index, (len(self.cloud),), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Boxes2D:
    """Boxes that one camera's picture shows.

    Attributes:
        stamp_ns: Time of the picture.
        frame_id: Camera optical frame.
        xyxy: (N, 4) float32, left, top, right, bottom in pixels; (0, 0) is the top left corner of the top left pixel.
        scores: (N,) float32 in [0, 1].
        class_ids: (N,) int32, row of the configured classes.
    """

    stamp_ns: int
    frame_id: str
    xyxy: npt.NDArray[np.float32]
    scores: npt.NDArray[np.float32]
    class_ids: npt.NDArray[np.int32]

    def __post_init__(self) -> None:
        n = len(self.scores)
        check_array("xyxy", self.xyxy, (n, 4), np.float32)
        check_array("scores", self.scores, (n,), np.float32)
        check_array("class_ids", self.class_ids, (n,), np.int32)

    def __len__(self) -> int:
        return len(self.scores)

    def select(self, rows: Rows) -> "Boxes2D":
        """The given rows (mask or indices), in that order."""
        return _select(self, rows)

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
        point_counts: (N,) int32, lidar points that the box was found from.
        covariances: (N, 3, 3) float64 over x, y (m^2) and yaw (rad^2); zeros where unknown.
    """

    stamp_ns: int
    frame_id: str
    centers: npt.NDArray[np.float64]
    sizes: npt.NDArray[np.float64]
    yaws: npt.NDArray[np.float64]
    scores: npt.NDArray[np.float32]
    class_ids: npt.NDArray[np.int32]
    point_counts: npt.NDArray[np.int32]
    covariances: npt.NDArray[np.float64]

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
        return _select(self, rows)

    @classmethod
    def empty(cls, stamp_ns: int, frame_id: str) -> Self:
        """No boxes."""
        return cls(
            stamp_ns,
            frame_id,
            np.zeros((0, 3)),
            np.zeros((0, 3)),
            np.zeros(0),
            np.zeros(0, np.float32),
            np.zeros(0, np.int32),
            np.zeros(0, np.int32),
            np.zeros((0, 3, 3)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Which 3D box is which 2D box of one camera; each row at most once.

    Attributes:
        pairs: (M, 2) int64: row of the 3D boxes, row of the camera's 2D boxes; in order of the 3D rows.
        iou: (M,) float32, overlap of the projected 3D box and the 2D box.
        projected_xyxy: (N, 4) float32, every 3D box in this picture in pixels, clipped to it; NaN where it is not seen.
    """

    pairs: npt.NDArray[np.int64]
    iou: npt.NDArray[np.float32]
    projected_xyxy: npt.NDArray[np.float32]

    def __post_init__(self) -> None:
        check_array("pairs", self.pairs, (len(self.iou), 2), np.int64)
        check_array("iou", self.iou, (len(self.iou),), np.float32)
        check_array("projected_xyxy", self.projected_xyxy, (len(self.projected_xyxy), 4), np.float32)

    def __len__(self) -> int:
        return len(self.iou)


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """Everything a writer needs of one frame.

    Attributes:
        bundle: The messages that the frame was made of; images are copied from here.
        combined: The combined cloud.
        lidar_boxes: What the lidars alone saw, in the site frame.
        camera_boxes: What each camera alone saw, by camera name.
        matches: By camera name, for every camera of the rig; for the rows of `lidar_boxes`.
        objects: The fused objects, in the site frame.
        matched: (N,) int32 for the rows of `objects`: number of cameras that confirm it.
        drops: Messages of the bundle that could not be used.
        left_out: Recorded 2D boxes that could not be used, by reason.
    """

    bundle: SensorBundle
    combined: CombinedCloud
    lidar_boxes: Boxes3D
    camera_boxes: Mapping[str, Boxes2D]
    matches: Mapping[str, Matches]
    objects: Boxes3D
    matched: npt.NDArray[np.int32]
    drops: tuple[Drop, ...] = ()
    left_out: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_array("matched", self.matched, (len(self.objects),), np.int32)


def _select(record: R, rows: Rows) -> R:
    values: dict[str, Any] = {f.name: getattr(record, f.name) for f in fields(record)}
    chosen: dict[str, Any] = {name: v[rows] if isinstance(v, np.ndarray) else v for name, v in values.items()}
    return type(record)(**chosen)
