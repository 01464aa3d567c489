"""Converts messages with Foxglove's sensor schemas, in protobuf or JSON, to the equivalent ROS 2 messages.

Sources: docs.foxglove.dev/docs/sdk/schemas (foxglove-sdk, schemas/), where in JSON bytes are base64 and a time is
`{"sec": ..., "nsec": ...}`; mcap.dev/spec/registry: a protobuf schema is a FileDescriptorSet, its name is the message's
full name. Unset fields have proto3's defaults; without a timestamp the stamp is the log time.
"""

import base64
import json
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64, U8
from lidcam.pipeline.core.errors import MessageError, is_short_memory
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import POINT_FIELD_DATATYPES, ROS2
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.text import one_line

Fields = dict[str, Any]

JSON_ITEMS = (b",", b"{", b"[")
"""Bytes that come before each value but the first, which is none of those that make up base64."""

JSON_KINDS: dict[str, tuple[str, type | tuple[type, ...]]] = {
    **dict.fromkeys(("timestamp", "pose", "position", "orientation", "translation", "rotation"), ("an object", dict)),
    **dict.fromkeys(("fields", "transforms", "D", "K", "R", "P"), ("a list", list)),
    **dict.fromkeys(("data", "format", "encoding", "distortion_model"), ("a text", str)),
    **dict.fromkeys(("frame_id", "parent_frame_id", "child_frame_id"), ("a text", str)),
    **dict.fromkeys((*"xyzw", "sec", "nsec", "width", "height", "step"), ("a number", (int, float, str))),
}
"""Type of a field's value, in words and in Python; long numbers may be texts."""

VARINT, LENGTH, FIXED_BYTES = 0, 2, {1: 8, 5: 4}
MAX_VARINT_BYTES = 10

_VIDEO, _CLOUD = "foxglove_msgs/msg/CompressedVideo", "foxglove_msgs/msg/CompressedPointCloud"

# foxglove.PackedElementField.NumericType
_NUMERIC_TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


@lru_cache(maxsize=1024)
def ros_channel(channel: Channel) -> Channel:
    """The channel of a Foxglove channel's messages after `to_ros`."""
    msgtype = ROS_TYPES[channel.msgtype]
    return Channel(channel.topic, msgtype, "cdr", ROS2.definition(msgtype), "ros2msg")


def to_ros(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> RawMessage:
    """The message as a ROS 2 message of `ros_channel`; without data and with a `problem` if it cannot be read.

    Its stamp is the message's timestamp; for transforms, which have a timestamp each, it is the log time.
    """
    source, channel = message.channel, ros_channel(message.channel)
    try:
        fields = _read_fields(message, limits=limits)
        stamp_ns = _time_ns(fields["timestamp"]) if "timestamp" in fields else message.log_time_ns
        data = ROS2.serialize(_SCHEMAS[source.msgtype][1](fields, stamp_ns))
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
    pose = Transform.from_quaternion("frame", "points", *_placed(fields.get("pose", {})))
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
    known = _known(fields, frame_id="", height=0, width=0, encoding="", step=0)
    return ROS2.image(stamp_ns, data=_data(fields), **known)


def _compressed_image(fields: Fields, stamp_ns: int) -> Any:
    return ROS2.compressed_image(stamp_ns, data=_data(fields), **_known(fields, frame_id="", format=""))


def _compressed(msgtype: str, fields: Fields, stamp_ns: int, **more: Any) -> Any:
    known = _known(fields, frame_id="", format="")
    return ROS2.new(msgtype, timestamp=ROS2.time(stamp_ns), data=_data(fields), **known, **more)


def _compressed_cloud(fields: Fields, stamp_ns: int) -> Any:
    placed = ROS2.pose(*_placed(fields.get("pose", {})))
    return _compressed(_CLOUD, fields, stamp_ns, pose=placed)


def _camera_calibration(fields: Fields, stamp_ns: int) -> Any:
    return ROS2.camera_info(
        stamp_ns,
        **_known(fields, frame_id="", height=0, width=0, distortion_model=""),
        d=np.array(fields.get("D", ()), np.float64),
        k=_matrix(fields, "K", np.zeros(9)),
        r=_matrix(fields, "R", np.eye(3).reshape(9)),  # only stereo cameras need R and P
        p=_matrix(fields, "P", np.zeros(12)),
    )


def _known(fields: Fields, **unset: int | str) -> dict[str, Any]:
    """The named fields, with their values where they are not set; numbers as int."""
    found = {name: fields.get(name, value) for name, value in unset.items()}
    return {name: int(value) if isinstance(unset[name], int) else value for name, value in found.items()}


def _data(fields: Fields) -> U8:
    return np.frombuffer(_payload(fields.get("data", b"")), np.uint8)


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
        stamp_ns = _time_ns(fields["timestamp"])
    return ROS2.transform_stamped(
        stamp_ns,
        fields.get("parent_frame_id", ""),
        fields.get("child_frame_id", ""),
        _numbers(fields.get("translation", {}), "xyz"),
        _rotation(fields.get("rotation", {})),
    )


def _placed(pose: Fields) -> tuple[list[float], list[float]]:
    return _numbers(pose.get("position", {}), "xyz"), _rotation(pose.get("orientation", {}))


def _rotation(fields: Fields) -> list[float]:
    """A quaternion x, y, z, w; without one (proto3 cannot tell zeros from unset fields) no rotation."""
    numbers = _numbers(fields, "xyzw")
    return numbers if any(numbers) else [0.0, 0.0, 0.0, 1.0]


def _numbers(fields: Fields, names: str) -> list[float]:
    return [float(fields.get(name, 0.0)) for name in names]


_SCHEMAS: dict[str, tuple[str, Callable[[Fields, int], Any]]] = {
    "foxglove.PointCloud": ("sensor_msgs/msg/PointCloud2", _point_cloud),
    "foxglove.RawImage": ("sensor_msgs/msg/Image", _raw_image),
    "foxglove.CompressedImage": ("sensor_msgs/msg/CompressedImage", _compressed_image),
    "foxglove.CompressedVideo": (
        "foxglove_msgs/msg/CompressedVideo",
        partial(_compressed, "foxglove_msgs/msg/CompressedVideo"),
    ),
    "foxglove.CompressedPointCloud": (_CLOUD, _compressed_cloud),
    "foxglove.CameraCalibration": ("sensor_msgs/msg/CameraInfo", _camera_calibration),
    "foxglove.FrameTransform": ("tf2_msgs/msg/TFMessage", _frame_transform),
    "foxglove.FrameTransforms": ("tf2_msgs/msg/TFMessage", _frame_transforms),
}
"""ROS 2 type by schema, and its conversion from fields and the stamp; a cloud's points are moved by its `pose`."""

ROS_TYPES = {schema: msgtype for schema, (msgtype, _) in _SCHEMAS.items()}


# --- protobuf and JSON as nested mappings of plain values by field name


def _read_fields(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> Fields:
    """The fields that are set, by name: messages as mappings, lists as lists; for bytes see `_payload`."""
    if message.channel.encoding == "json":
        text = bytes(message.data)
        _check_items(sum(map(text.count, JSON_ITEMS)), message.topic, limits)
        found = json.loads(text, object_hook=_set_values)
        if not isinstance(found, dict):
            raise MessageError(f"{message.topic}: expected a JSON object, found {type(found).__name__}")
        return found
    message_class = _message_class(message.channel)
    if isinstance(message_class, str):
        raise MessageError(f"{message.topic}: {message_class}")
    data = memoryview(message.data)
    values = _count_values(data, message_class.DESCRIPTOR, limits.max_message_items)
    _check_items(values, message.topic, limits)
    return _set_fields(message_class.FromString(data))


def _set_values(fields: Fields) -> Fields:
    """The fields of a JSON object but for nulls, which are unset; raises `MessageError` for a value of another kind."""
    found = {name: value for name, value in fields.items() if value is not None}
    for name, value in found.items():
        words, kind = JSON_KINDS.get(name, ("", object))
        if not isinstance(value, kind):
            raise MessageError(f"{name}: expected {words}, found {str(value)[:50]}")
    return found


def _check_items(items: int, topic: str, limits: RecordingLimits) -> None:
    if items > limits.max_message_items:
        raise MessageError(f"{topic}: a message with more than {limits.max_message_items} values: raise limit_scale")


def _count_values(data: memoryview, descriptor: Any, max_values: int) -> int:
    """Number of values in a protobuf message, texts and bytes as one each; stops beyond `max_values`, and at damage.

    Google's parser holds a hundred bytes for a nested message of two.
    """
    count, waiting = 0, [(data, descriptor)]
    while waiting:
        part, kind = waiting.pop()
        at = 0
        while at < len(part) and count <= max_values:
            count += 1
            key, at = _varint(part, at)
            wire = key & 7
            if wire == VARINT:
                _, at = _varint(part, at)
            elif wire != LENGTH:
                at += FIXED_BYTES.get(wire, 0)
            else:
                size, at = _varint(part, at)
                field = None if kind is None else kind.fields_by_number.get(key >> 3)
                if field is not None and field.message_type is not None:
                    waiting.append((part[at : at + size], field.message_type))
                elif field is not None and field.type not in {field.TYPE_BYTES, field.TYPE_STRING}:
                    count += min(size, len(part) - at)  # numbers one after the other, a byte each or more
                at += size
    return count


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """A number, and where it ends; at the end of the data zero."""
    value = 0
    for place, byte in enumerate(data[at : at + MAX_VARINT_BYTES]):
        value |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            return value, at + place + 1
    return 0, len(data)


def _payload(value: bytes | str) -> bytes:
    """A field of bytes; in JSON it is base64."""
    try:
        return base64.b64decode(value, validate=True) if isinstance(value, str) else value
    except ValueError as err:
        raise MessageError(f"{len(value)} characters of data: expected base64, found {value[:50]!r} ({err})") from err


def _time_ns(value: Fields) -> int:
    """A google.protobuf.Timestamp, or Foxglove's JSON form of it, in nanoseconds."""
    sec: Any = value.get("sec", value.get("seconds", 0))
    nanosec: Any = value.get("nsec", value.get("nanos", 0))
    return int(sec) * 10**9 + int(nanosec)


@lru_cache(maxsize=256)
def _message_class(channel: Channel) -> Any | str:
    """The class of a protobuf channel's messages, or why there is none: failures are cached too."""
    # Google's library is imported for recordings that have such messages.
    from google.protobuf.descriptor_database import DescriptorDatabase
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    try:
        database = DescriptorDatabase()
        for file in FileDescriptorSet.FromString(base64.b64decode(channel.definition)).file:
            database.Add(file)
        return GetMessageClass(DescriptorPool(database).FindMessageTypeByName(channel.msgtype))
    except Exception as err:  # protobuf's own errors, TypeError, KeyError or ValueError
        if is_short_memory(err):
            raise
        reason = one_line(err, max_characters=200)
        return f"the recorded protobuf schema of {channel.msgtype} is unusable: {type(err).__name__}: {reason}"


def _set_fields(message: Any) -> Fields:
    found = {}
    for descriptor, value in message.ListFields():
        if descriptor.message_type is None:
            found[descriptor.name] = value
        elif descriptor.is_repeated:
            found[descriptor.name] = [_set_fields(item) for item in value]
        else:
            found[descriptor.name] = _set_fields(value)
    return found
