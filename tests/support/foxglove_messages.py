"""Messages with Foxglove's schemas, in protobuf by Google's runtime and in JSON: an independent writer for our readers.

A message is a mapping of the schema's field names: times are integers in nanoseconds, payloads bytes, enumerations
numbers. `twin` says in a Foxglove schema what a ROS message says.
"""

import json
import re
from base64 import b64encode
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.message_factory import GetMessages

from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.messages.deserialize import deserialize

Encoding = Literal["protobuf", "json"]
Fields = Mapping[str, Any]

TIME = "google.protobuf.Timestamp"

PROTO = """
message Vector3 { double x = 1; double y = 2; double z = 3; }
message Quaternion { double x = 1; double y = 2; double z = 3; double w = 4; }
message Pose { foxglove.Vector3 position = 1; foxglove.Quaternion orientation = 2; }
message PackedElementField { string name = 1; fixed32 offset = 2; int32 type = 3; }
message PointCloud {
  google.protobuf.Timestamp timestamp = 1; string frame_id = 2; foxglove.Pose pose = 3; fixed32 point_stride = 4;
  repeated foxglove.PackedElementField fields = 5; bytes data = 6;
}
message RawImage {
  google.protobuf.Timestamp timestamp = 1; string frame_id = 7; fixed32 width = 2; fixed32 height = 3;
  string encoding = 4; fixed32 step = 5; bytes data = 6;
}
message CompressedImage {
  google.protobuf.Timestamp timestamp = 1; string frame_id = 4; bytes data = 2; string format = 3;
}
message CompressedPointCloud {
  google.protobuf.Timestamp timestamp = 1; string frame_id = 2; foxglove.Pose pose = 3; bytes data = 4;
  string format = 5;
}
message CompressedVideo {
  google.protobuf.Timestamp timestamp = 1; string frame_id = 2; bytes data = 3; string format = 4;
}
message CameraCalibration {
  google.protobuf.Timestamp timestamp = 1; string frame_id = 9; fixed32 width = 2; fixed32 height = 3;
  string distortion_model = 4; repeated double D = 5; repeated double K = 6; repeated double R = 7;
  repeated double P = 8;
}
message FrameTransform {
  google.protobuf.Timestamp timestamp = 1; string parent_frame_id = 2; string child_frame_id = 3;
  foxglove.Vector3 translation = 4; foxglove.Quaternion rotation = 5;
}
message FrameTransforms { repeated foxglove.FrameTransform transforms = 1; }
"""
"""Names, numbers and types as in the package foxglove-schemas-protobuf 0.4.0."""


SCHEMAS = {
    schema: {
        name: (kind, int(number), bool(repeated))
        for repeated, kind, name, number in re.findall(r"(repeated )?([\w.]+) (\w+) = (\d+);", fields)
    }
    for schema, fields in re.findall(r"message (\w+) {([^}]*)}", PROTO)
}
"""Type, number, and whether it is a list, of each field by schema and name."""

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
def _descriptors() -> FileDescriptorSet:
    time = FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(time)
    file = FileDescriptorProto(name="foxglove.proto", package="foxglove", syntax="proto3", dependency=[time.name])
    for schema, fields in SCHEMAS.items():
        message = file.message_type.add(name=schema)
        for name, (kind, number, is_list) in fields.items():
            label = FieldDescriptorProto.LABEL_REPEATED if is_list else FieldDescriptorProto.LABEL_OPTIONAL
            added = message.field.add(name=name, number=number, label=label)
            if "." in kind:
                added.type, added.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{kind}"
            else:
                added.type = getattr(FieldDescriptorProto, f"TYPE_{kind.upper()}")
    return FileDescriptorSet(file=[file, time])  # a file before its dependency: the specification sets no order


@lru_cache
def _classes() -> dict[str, Any]:
    return dict(GetMessages([*reversed(_descriptors().file)]))


@lru_cache
def _channel(topic: str, schema: str, encoding: Encoding) -> Channel:
    if encoding == "json":
        return Channel(topic, schema, "json", '{"type": "object"}', "jsonschema")
    return Channel(topic, schema, "protobuf", b64encode(_descriptors().SerializeToString()).decode(), "protobuf")


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
    written = _written(schema.removeprefix("foxglove."), fields, encoding)
    is_json = encoding == "json"
    data = json.dumps(written).encode() if is_json else bytes(_classes()[schema](**written).SerializeToString())
    return RawMessage(log_time_ns, log_time_ns, order, data, _channel(topic, schema, encoding))


def twin(message: RawMessage, encoding: Encoding) -> RawMessage:
    """The same measurement with a Foxglove schema; a message of a type without one as it is."""
    schema = SCHEMA_OF.get(message.channel.msgtype)
    if schema is None:
        return message
    fields = _FIELDS[schema](deserialize(message))
    return foxglove_raw(message.topic, schema, fields, message.log_time_ns, encoding, order=message.order)


def _written(schema: str, fields: Fields, encoding: Encoding) -> dict[str, Any]:
    """Fields as the encoding has them: times in two parts; in JSON, bytes as text."""
    found: dict[str, Any] = {}
    for name, value in fields.items():
        kind, _, is_list = SCHEMAS[schema][name]
        inner = kind.removeprefix("foxglove.")
        if kind == TIME:
            names = ("sec", "nsec") if encoding == "json" else ("seconds", "nanos")
            found[name] = dict(zip(names, divmod(value, 10**9), strict=True))
        elif kind == "bytes" and encoding == "json":
            found[name] = b64encode(value).decode()
        elif inner in SCHEMAS:
            items = [_written(inner, item, encoding) for item in (value if is_list else [value])]
            found[name] = items if is_list else items[0]
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
