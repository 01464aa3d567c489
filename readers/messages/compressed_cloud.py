"""Unpacks and decodes compressed clouds: those of ROS's point_cloud_transport, and Foxglove's CompressedPointCloud.

point_cloud_transport compresses the data of a PointCloud2 with zstd or with what it calls zlib (in fact gzip's form),
or makes a Draco cloud with one attribute for each field, in the order of the fields (draco_publisher.cpp, zlib_cpp.cpp
of github.com/ros-perception/point_cloud_transport_plugins). Foxglove's Draco clouds have x, y and z in one attribute,
and the names of the other fields in its metadata (rust/foxglove/src/draco.rs of github.com/foxglove/foxglove-sdk).

DracoPy rounds float64 to float32: such times of points are lost, which the log says (see `pointcloud2`).
"""

import zlib
from importlib.util import find_spec
from typing import Any

import numpy as np
import zstandard

from lidcam.pipeline.core.arrays import U8, Array
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as, pose_numbers
from lidcam.readers.messages.pointcloud2 import check_points, cloud_of_fields

FOXGLOVE_CLOUD = "foxglove_msgs/msg/CompressedPointCloud"
COMPRESSED_CLOUDS = (
    "point_cloud_interfaces/msg/CompressedPointCloud2",
    "draco_point_cloud_transport/msg/CompressedPointCloud2",  # of ROS 1
    FOXGLOVE_CLOUD,
)

MAX_POINT_BYTES = 256
"""Largest size of a point: those of drivers have at most 64 bytes."""

GZIP_OR_ZLIB = 32 + zlib.MAX_WBITS
"""Makes zlib recognise both forms by their first bytes."""


@decoder
def decode_compressed_cloud(
    message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0, calibrated: bool = True
) -> PointCloud:
    """The points of a message, as of the PointCloud2 that it was made of; see `decode_pointcloud2`."""
    return cloud_of_fields(message, unpack_cloud(message, limits=limits, others=others), calibrated=calibrated)


@decoder
def unpack_cloud(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> Any:
    """The sensor_msgs/PointCloud2 that a message was made of; of Foxglove's, with the points moved by its pose."""
    packed, topic = deserialize_as(message, *COMPRESSED_CLOUDS, limits=limits), message.topic
    format_name = str(getattr(packed, "format", "draco")).strip().lower()
    if packed.__msgtype__ == FOXGLOVE_CLOUD:
        if format_name != "draco":
            raise _unknown(topic, format_name, "draco")
        columns = _foxglove_columns(_draco(packed.data, topic, limits, others), packed.pose, topic)
        return ROS2.cloud(message.stamp_ns, packed.frame_id, columns)
    if format_name == "draco":
        columns = _columns(_draco(packed.compressed_data, topic, limits, others), packed.fields, topic)
        return ROS2.cloud(message.stamp_ns, packed.header.frame_id, columns)
    if format_name not in {"zlib", "zstd"}:
        raise _unknown(topic, format_name, "draco, zlib or zstd")
    check_points(int(packed.width), topic, limits, others, rows=int(packed.height))
    size = int(packed.height) * max(int(packed.row_step), int(packed.width) * int(packed.point_step))
    if size > limits.max_points * MAX_POINT_BYTES:
        raise MessageError(f"{topic}: {packed.width} points of {size} bytes in all: raise limit_scale")
    names = ("height", "width", "fields", "is_bigendian", "point_step", "row_step", "is_dense")
    same = {name: getattr(packed, name) for name in names}
    data = _unpacked(packed.compressed_data.tobytes(), format_name, size, topic)
    return ROS2.new("sensor_msgs/msg/PointCloud2", header=packed.header, data=data, **same)


def _unknown(topic: str, format_name: str, expected: str) -> MessageError:
    return MessageError(
        f"{topic}: a cloud compressed by {format_name[:50]!r}, expected {expected}: play the recording through "
        "point_cloud_transport's republish and record the PointCloud2"
    )


def _unpacked(data: bytes, format_name: str, size: int, topic: str) -> U8:
    """The content of zlib or zstd, at most `size` bytes; steps of rows may be wrong, see `pointcloud2`."""
    try:
        if format_name == "zstd":
            found = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
        else:
            found = zlib.decompressobj(GZIP_OR_ZLIB).decompress(data, size + 1)
    except (zlib.error, zstandard.ZstdError) as err:
        raise MessageError(f"{topic}: {len(data)} bytes that {format_name} cannot unpack ({err})") from err
    if len(found) > size:
        raise MessageError(f"{topic}: {format_name} unpacks to more bytes, expected {size}")
    return np.frombuffer(found, np.uint8)


# --- Draco


def missing_draco() -> str:
    """Why Draco's clouds cannot be decoded on this machine and what to do; empty if they can."""
    if find_spec("DracoPy") is not None:
        return ""
    return "it is compressed by Draco, which needs DracoPy: pip install 'lidcam[draco]'"


def _draco(data: U8, topic: str, limits: RecordingLimits, others: int) -> list[Any]:
    """The attributes of a cloud in the order of the encoder, as DracoPy gives them: `data` is (N, K)."""
    if problem := missing_draco():
        raise MessageError(f"{topic}: {problem}")
    import DracoPy

    packed = data.tobytes()
    try:
        check_points(draco_points(packed), topic, limits, others)
        return list(DracoPy.decode(packed).attributes)
    except (DracoPy.FileTypeException, ValueError) as err:
        raise MessageError(f"{topic}: {len(packed)} bytes that are no usable cloud of Draco ({err})") from err


def _columns(attributes: list[Any], fields: list[Any], topic: str) -> dict[str, Array]:
    """The first column of each attribute by the name of its field."""
    if len(attributes) != len(fields):
        raise MessageError(f"{topic}: {len(attributes)} attributes of Draco for {len(fields)} fields")
    return {field.name: one["data"][:, 0] for field, one in zip(fields, attributes, strict=True)}


def _foxglove_columns(attributes: list[Any], pose: Any, topic: str) -> dict[str, Array]:
    """The points, moved by the pose, and the named attributes."""
    positions = (one["data"] for one in attributes if one["attribute_type"] == POSITION)
    xyz = next((values for values in positions if values.shape[1] == 3), None)
    if xyz is None:
        raise MessageError(f"{topic}: a cloud of Draco without positions of three coordinates")
    position, turn = pose_numbers(pose)
    moved = Transform.from_quaternion("frame", "points", position, turn if any(turn) else [0.0, 0.0, 0.0, 1.0])
    if not np.array_equal(moved.matrix, np.eye(4)):
        xyz = moved.apply(xyz)
    named = {one["name"]: one["data"][:, 0] for one in attributes if one["name"]}
    return {**named, **{axis: xyz[:, index] for index, axis in enumerate("xyz")}}


VERSION, POINT_CLOUD, POSITION, SEQUENTIAL = 2, 0, 0, 0
HAS_METADATA = 0x8000
HEAD_BYTES = 11
TYPE_BYTES = (8, 1, 1, 2, 2, 4, 4, 8, 8, 4, 8, 1)
"""Sizes of Draco's types of numbers, by their numbers."""


def draco_points(data: bytes) -> int:
    """Number of points that Draco will take memory for, from the head of a cloud.

    Sources: google.github.io/draco/spec; decoders in src/draco/compression of github.com/google/draco.

    Raises:
        ValueError: the data are no cloud of Draco or end too soon, or a point has more than `MAX_POINT_BYTES`.
    """
    if data[:5] != b"DRACO" or data[5:6] != bytes([VERSION]) or data[7:8] != bytes([POINT_CLOUD]):
        raise ValueError(f"expected a point cloud of Draco {VERSION}, found bytes that begin {data[:8].hex()}")
    head = _Head(data, HEAD_BYTES)
    if int.from_bytes(data[9:11], "little") & HAS_METADATA:
        for _ in range(head.varint()):
            head.varint()  # the attribute's number
            head.skip_metadata()
        head.skip_metadata()
    points, decoders, point_bytes = int.from_bytes(head.take(4), "little"), head.take(1)[0], 0
    for _ in range(decoders):
        attributes = head.varint()
        for _ in range(attributes):
            _, kind, components, _ = head.take(4)
            point_bytes += TYPE_BYTES[kind % len(TYPE_BYTES)] * components
            head.varint()  # its number
        head.take(attributes if data[8] == SEQUENTIAL else 0)  # how each one is encoded
    if point_bytes > MAX_POINT_BYTES:
        raise ValueError(f"points of {point_bytes} bytes, expected at most {MAX_POINT_BYTES}")
    return points


class _Head:
    """A place in the head of a Draco cloud; its methods raise ValueError where that ends."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data, self._at = data, at

    def take(self, size: int) -> bytes:
        self._at += size
        if self._at > len(self._data):
            raise ValueError("its head is cut off")
        return self._data[self._at - size : self._at]

    def varint(self) -> int:
        """A number of seven bits a byte, the lowest first."""
        value = shift = 0
        while (byte := self.take(1)[0]) >= 0x80:
            value, shift = value | (byte & 0x7F) << shift, shift + 7
        return value | byte << shift

    def skip_metadata(self) -> None:
        """Pass over names and their values."""
        for _ in range(self.varint()):
            self.take(self.take(1)[0])
            self.take(self.varint())
        if self.varint():
            raise ValueError("its metadata hold others, which no writer of clouds needs")
