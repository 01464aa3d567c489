"""Converts messages with Foxglove's sensor schemas, in protobuf or JSON, to the equivalent ROS 2 messages.

Source: docs.foxglove.dev/docs/sdk/schemas (foxglove-sdk, schemas/). Unset fields have proto3's defaults; without a
timestamp the stamp is the log time.

| Foxglove | ROS 2 |
| --- | --- |
| foxglove.PointCloud | sensor_msgs/PointCloud2, its points moved by `pose` |
| foxglove.RawImage | sensor_msgs/Image |
| foxglove.CompressedImage | sensor_msgs/CompressedImage |
| foxglove.CompressedVideo | foxglove_msgs/CompressedVideo |
| foxglove.CameraCalibration | sensor_msgs/CameraInfo |
| foxglove.FrameTransform, foxglove.FrameTransforms | tf2_msgs/TFMessage |
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.core.arrays import F64, U8
from pipeline.core.errors import MessageError, is_short_memory
from pipeline.core.geometry.transform import Transform
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.ros.messages import POINT_FIELD_DATATYPES, ROS2
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from pipeline.core.text import one_line
from readers.messages.foxglove_wire import Fields, payload, read_fields, time_ns

__all__ = ["ROS_TYPES", "ros_channel", "to_ros"]

ROS_TYPES = {
    "foxglove.PointCloud": "sensor_msgs/msg/PointCloud2",
    "foxglove.RawImage": "sensor_msgs/msg/Image",
    "foxglove.CompressedImage": "sensor_msgs/msg/CompressedImage",
    "foxglove.CompressedVideo": "foxglove_msgs/msg/CompressedVideo",
    "foxglove.CameraCalibration": "sensor_msgs/msg/CameraInfo",
    "foxglove.FrameTransform": "tf2_msgs/msg/TFMessage",
    "foxglove.FrameTransforms": "tf2_msgs/msg/TFMessage",
}
"""ROS 2 type by schema."""

# foxglove.PackedElementField.NumericType
_NUMERIC_TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


@lru_cache(maxsize=1024)
def ros_channel(channel: Channel) -> Channel:
    """The channel of a Foxglove channel's messages after `to_ros`."""
    msgtype = ROS_TYPES[channel.msgtype]
    return Channel(channel.topic, msgtype, "cdr", ROS2.definition(msgtype), "ros2msg")


def to_ros(message: RawMessage, *, limits: LimitsConfig = DEFAULT_LIMITS) -> RawMessage:
    """The message as a ROS 2 message of `ros_channel`; without data and with a `problem` if it cannot be read.

    Its stamp is the message's timestamp; for transforms, which have a timestamp each, it is the log time.
    """
    source, channel = message.channel, ros_channel(message.channel)
    try:
        fields = read_fields(message, limits=limits)
        stamp_ns = time_ns(fields["timestamp"]) if "timestamp" in fields else message.log_time_ns
        data = ROS2.serialize(_CONVERSIONS[source.msgtype](fields, stamp_ns))
    except Exception as err:  # JSON values of any type, and errors of protobuf and rosbags
        if is_short_memory(err):
            raise
        reason = one_line(err if isinstance(err, MessageError) else f"{type(err).__name__}: {err}")
        found = f"{len(message.data)} bytes are not a valid {source.msgtype} in {source.encoding} ({reason})"
        return message._replace(data=b"", channel=channel, problem=found)
    if channel.msgtype == "tf2_msgs/msg/TFMessage":
        stamp_ns = message.log_time_ns
    return message._replace(stamp_ns=stamp_ns, data=data, channel=channel)


def _point_cloud(fields: Fields, stamp_ns: int) -> Any:
    step = int(fields.get("point_stride", 0))
    data = _data(fields)
    if len(data) and (step <= 0 or len(data) % step):
        raise MessageError(f"{len(data)} bytes of data are not whole points of {step} bytes")
    width = len(data) // step if step else 0
    elements = []
    for element in fields.get("fields", ()):
        kind = int(element.get("type", 0))
        if kind not in _NUMERIC_TYPES:
            raise MessageError(f"field {element.get('name', '')!r} has type {kind}, expected 1 to 8")
        datatype = POINT_FIELD_DATATYPES[_NUMERIC_TYPES[kind]]
        elements.append((element.get("name", ""), int(element.get("offset", 0)), datatype))
    pose = _pose(fields.get("pose", {}))
    if width and not np.array_equal(pose.matrix, np.eye(4)):
        data = _moved(data, width, step, fields["fields"], pose)
    frame_id = fields.get("frame_id", "")
    return ROS2.point_cloud2(stamp_ns, frame_id, elements, data, point_step=step, is_dense=False)


def _moved(data: U8, width: int, step: int, elements: list[Fields], pose: Transform) -> U8:
    """The points moved by `pose` into the cloud's frame."""
    places = {element.get("name", ""): element for element in reversed(elements)}  # of equal names the first is used
    if not {"x", "y", "z"} <= places.keys():
        raise MessageError("a pose, but not the fields x, y and z")
    formats = ["<" + _NUMERIC_TYPES[int(places[axis]["type"])] for axis in "xyz"]
    if any(kind not in {"<f4", "<f8"} for kind in formats):
        raise MessageError(f"a pose, but coordinates of type {', '.join(formats)}: expected float")
    moved = data.copy()
    layout: Any = {
        "names": [*"xyz"],
        "formats": formats,
        "offsets": [int(places[axis].get("offset", 0)) for axis in "xyz"],
        "itemsize": step,
    }
    points = np.ndarray((width,), np.dtype(layout), moved)
    xyz = np.column_stack([points[axis].astype(np.float64) for axis in "xyz"])
    with np.errstate(over="ignore", invalid="ignore"):  # points without a return are NaN or infinite
        xyz = xyz @ pose.matrix[:3, :3].T + pose.matrix[:3, 3]
        for axis, column in zip("xyz", xyz.T, strict=True):
            points[axis] = column
    return moved


def _raw_image(fields: Fields, stamp_ns: int) -> Any:
    return ROS2.image(
        stamp_ns,
        fields.get("frame_id", ""),
        height=int(fields.get("height", 0)),
        width=int(fields.get("width", 0)),
        encoding=fields.get("encoding", ""),
        step=int(fields.get("step", 0)),
        data=_data(fields),
    )


def _compressed_image(fields: Fields, stamp_ns: int) -> Any:
    return ROS2.compressed_image(stamp_ns, fields.get("frame_id", ""), fields.get("format", ""), _data(fields))


def _compressed_video(fields: Fields, stamp_ns: int) -> Any:
    return ROS2.new(
        "foxglove_msgs/msg/CompressedVideo",
        timestamp=ROS2.time(stamp_ns),
        frame_id=fields.get("frame_id", ""),
        data=_data(fields),
        format=fields.get("format", ""),
    )


def _camera_calibration(fields: Fields, stamp_ns: int) -> Any:
    return ROS2.camera_info(
        stamp_ns,
        fields.get("frame_id", ""),
        height=int(fields.get("height", 0)),
        width=int(fields.get("width", 0)),
        distortion_model=fields.get("distortion_model", ""),
        d=np.array(fields.get("D", ()), np.float64),
        k=_matrix(fields, "K", np.zeros(9)),
        r=_matrix(fields, "R", np.eye(3).reshape(9)),  # only stereo cameras need R and P
        p=_matrix(fields, "P", np.zeros(12)),
    )


def _data(fields: Fields) -> U8:
    return np.frombuffer(payload(fields.get("data", b"")), np.uint8)


def _matrix(fields: Fields, name: str, unset: F64) -> F64:
    values = np.array(fields.get(name, ()), np.float64)
    if values.shape not in {(0,), unset.shape}:
        raise MessageError(f"{name} has {values.size} numbers, expected {len(unset)}")
    return values if len(values) else unset


def _frame_transforms(fields: Fields, stamp_ns: int) -> Any:
    stamped = [_transform_stamped(item, stamp_ns) for item in fields.get("transforms", ())]
    return ROS2.new("tf2_msgs/msg/TFMessage", stamped)


def _frame_transform(fields: Fields, stamp_ns: int) -> Any:
    return _frame_transforms({"transforms": [fields]}, stamp_ns)


def _transform_stamped(fields: Fields, stamp_ns: int) -> Any:
    if "timestamp" in fields:
        stamp_ns = time_ns(fields["timestamp"])
    return ROS2.transform_stamped(
        stamp_ns,
        fields.get("parent_frame_id", ""),
        fields.get("child_frame_id", ""),
        _numbers(fields.get("translation", {}), "xyz"),
        _rotation(fields.get("rotation", {})),
    )


def _pose(fields: Fields) -> Transform:
    position, orientation = _numbers(fields.get("position", {}), "xyz"), _rotation(fields.get("orientation", {}))
    return Transform.from_quaternion("frame", "points", position, orientation)


def _rotation(fields: Fields) -> list[float]:
    """A quaternion x, y, z, w; without one (proto3 cannot tell zeros from unset fields) no rotation."""
    numbers = _numbers(fields, "xyzw")
    return numbers if any(numbers) else [0.0, 0.0, 0.0, 1.0]


def _numbers(fields: Fields, names: str) -> list[float]:
    return [float(fields.get(name, 0.0)) for name in names]


_CONVERSIONS: dict[str, Callable[[Fields, int], Any]] = {
    "foxglove.PointCloud": _point_cloud,
    "foxglove.RawImage": _raw_image,
    "foxglove.CompressedImage": _compressed_image,
    "foxglove.CompressedVideo": _compressed_video,
    "foxglove.CameraCalibration": _camera_calibration,
    "foxglove.FrameTransform": _frame_transform,
    "foxglove.FrameTransforms": _frame_transforms,
}
