"""Messages with Foxglove's schemas, in protobuf by Google's runtime and in JSON: an independent writer for our readers.

The schemas are those of Foxglove's SDK. A message is a mapping of a schema's field names: times are integers in
nanoseconds, payloads bytes, enumerations numbers. `twin` says in a Foxglove schema what a ROS message says.
"""

import json
from base64 import b64encode
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Literal

import foxglove.messages
import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message_factory import GetMessages

from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.messages.deserialize import deserialize

Encoding = Literal["protobuf", "json"]
Fields = Mapping[str, Any]

TIME = "google.protobuf.Timestamp"

SCHEMA_OF = {
    "sensor_msgs/msg/PointCloud2": "foxglove.PointCloud",
    "sensor_msgs/msg/Image": "foxglove.RawImage",
    "sensor_msgs/msg/CompressedImage": "foxglove.CompressedImage",
    "foxglove_msgs/msg/CompressedVideo": "foxglove.CompressedVideo",
    "sensor_msgs/msg/CameraInfo": "foxglove.CameraCalibration",
    "tf2_msgs/msg/TFMessage": "foxglove.FrameTransforms",
}

# foxglove.NumericType by sensor_msgs/PointField datatype.
NUMERIC_TYPES = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}


@lru_cache
def _descriptors(schema: str) -> FileDescriptorSet:
    """Foxglove's own description of a schema, dependencies last: the specification sets no order."""
    known = getattr(foxglove.messages, schema.removeprefix("foxglove.")).get_schema()
    return FileDescriptorSet(file=reversed(FileDescriptorSet.FromString(known.data).file))


@lru_cache
def _class(schema: str) -> Any:
    return GetMessages([*reversed(_descriptors(schema).file)])[schema]


@lru_cache
def _channel(topic: str, schema: str, encoding: Encoding) -> Channel:
    if encoding == "json":
        return Channel(topic, schema, "json", '{"type": "object"}', "jsonschema")
    return Channel(topic, schema, "protobuf", b64encode(_descriptors(schema).SerializeToString()).decode(), "protobuf")


def foxglove_raw(
    topic: str,
    schema: str,
    fields: Fields,
    log_time_ns: int,
    encoding: Encoding = "protobuf",
    *,
    order: tuple[int, ...] = (0, 0),
) -> RawMessage:
    """An undecoded message as the MCAP reader yields it, with the log time as its stamp."""
    kind = _class(schema)
    written = _written(kind.DESCRIPTOR, fields, encoding)
    data = json.dumps(written).encode() if encoding == "json" else bytes(kind(**written).SerializeToString())
    return RawMessage(log_time_ns, log_time_ns, order, data, _channel(topic, schema, encoding))


def twin(message: RawMessage, encoding: Encoding) -> RawMessage:
    """The same measurement with a Foxglove schema; a message of a type without one as it is."""
    schema = SCHEMA_OF.get(message.channel.msgtype)
    if schema is None:
        return message
    fields = _FIELDS[schema](deserialize(message))
    return foxglove_raw(message.topic, schema, fields, message.log_time_ns, encoding, order=message.order)


def _written(descriptor: Any, fields: Fields, encoding: Encoding) -> dict[str, Any]:
    """Fields as the encoding has them: times in two parts; in JSON, bytes as text."""
    found: dict[str, Any] = {}
    for name, value in fields.items():
        field = descriptor.fields_by_name[name]
        inner, is_list = field.message_type, field.is_repeated
        if inner is not None and inner.full_name == TIME:
            names = ("sec", "nsec") if encoding == "json" else ("seconds", "nanos")
            found[name] = dict(zip(names, divmod(value, 10**9), strict=True))
        elif inner is not None:
            items = [_written(inner, item, encoding) for item in (value if is_list else [value])]
            found[name] = items if is_list else items[0]
        elif field.type == field.TYPE_BYTES and encoding == "json":
            found[name] = b64encode(value).decode()
        else:
            found[name] = [*value] if is_list else value
    return found


def _time(stamp: Any) -> int:
    return int(stamp.sec * 10**9 + stamp.nanosec)


def _labelled(message: Any) -> dict[str, Any]:
    return {"timestamp": _time(message.header.stamp), "frame_id": message.header.frame_id}


def _image(message: Any, *names: str) -> dict[str, Any]:
    return {**_labelled(message), **{name: getattr(message, name) for name in names}, "data": message.data.tobytes()}


def _numbers(message: Any, names: str) -> dict[str, float]:
    return {name: float(getattr(message, name)) for name in names}


_FIELDS: dict[str, Any] = {
    "foxglove.PointCloud": lambda m: {
        **_labelled(m),
        "pose": {"position": {}, "orientation": {"w": 1.0}},
        "point_stride": m.point_step,
        "fields": [{"name": f.name, "offset": f.offset, "type": NUMERIC_TYPES[f.datatype]} for f in m.fields],
        "data": m.data.tobytes(),
    },
    "foxglove.RawImage": lambda m: _image(m, "width", "height", "encoding", "step"),
    "foxglove.CompressedImage": lambda m: _image(m, "format"),
    "foxglove.CompressedVideo": lambda m: {
        "timestamp": _time(m.timestamp),
        "frame_id": m.frame_id,
        "data": m.data.tobytes(),
        "format": m.format,
    },
    "foxglove.CameraCalibration": lambda m: {
        **_labelled(m),
        "width": m.width,
        "height": m.height,
        "distortion_model": m.distortion_model,
        **{n: np.asarray(getattr(m, n, getattr(m, n.lower(), ()))).tolist() for n in "DKRP"},
    },
    "foxglove.FrameTransforms": lambda m: {
        "transforms": [
            {
                "timestamp": _time(t.header.stamp),
                "parent_frame_id": t.header.frame_id,
                "child_frame_id": t.child_frame_id,
                "translation": _numbers(t.transform.translation, "xyz"),
                "rotation": _numbers(t.transform.rotation, "xyzw"),
            }
            for t in m.transforms
        ]
    },
}
