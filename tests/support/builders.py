"""ROS messages and recordings for tests, built with rosbags' type stores: an independent writer for our readers.

A message is a plain mapping of field names in the ROS 2 spelling (`k`, `nanosec`); fields that are left out are zero or
empty. The same mapping serialises to ROS 1 and to CDR: names that ROS 1 writes in capitals (`CameraInfo.K`) are
found regardless of case.
"""

from base64 import b64decode
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.typestores import message_types
from lidcam.readers.messages.deserialize import typestore_for

Fields = Mapping[str, Any]
Encoding = Literal["ros1", "cdr"]

# Packages of types that rosbags does not bring for one ROS version or both; in ROS 1, vision_msgs are as in ROS 2.
MORE_PACKAGES = (
    *("ffmpeg_image_transport_msgs/", "foxglove_msgs/", "livox_", "ouster_"),
    *("point_cloud_interfaces/", "tf2_msgs/", "velodyne_msgs/", "vision_msgs/"),
)

# sensor_msgs/PointField constants.
POINT_FIELD_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

# --- messages as mappings


def time(stamp_ns: int) -> Fields:
    """builtin_interfaces/Time."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    return {"sec": sec, "nanosec": nanosec}


def header(stamp_ns: int, frame_id: str) -> Fields:
    """std_msgs/Header."""
    return {"stamp": time(stamp_ns), "frame_id": frame_id}


def pointcloud2(
    xyz: npt.ArrayLike,
    *,
    stamp_ns: int,
    frame_id: str = "lidar",
    height: int = 1,
    point_padding: int = 0,
    row_padding: int = 0,
    is_bigendian: bool = False,
    **extra: Array,
) -> Fields:
    """sensor_msgs/PointCloud2 with x, y, z in the dtype of `xyz`, then the extra fields in theirs, tightly packed.

    `height` > 1 makes it organised; `point_padding` and `row_padding` are bytes of filling after each point and row.
    """
    points = np.asarray(xyz, None if isinstance(xyz, np.ndarray) else np.float32).reshape(-1, 3)
    columns = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2], **extra}
    order: Literal["<", ">"] = ">" if is_bigendian else "<"
    formats = [column.dtype.newbyteorder(order) for column in columns.values()]
    offsets = np.cumsum([0, *(f.itemsize for f in formats)])
    point_step = int(offsets[-1]) + point_padding
    layout: Any = {"names": [*columns], "formats": formats, "offsets": offsets[:-1].tolist(), "itemsize": point_step}
    table = np.zeros(len(points), np.dtype(layout))
    for name, column in columns.items():
        table[name] = column
    width = len(points) // height
    rows = np.frombuffer(table.tobytes(), np.uint8).reshape(height, width * point_step)
    return {
        "header": header(stamp_ns, frame_id),
        "height": height,
        "width": width,
        "fields": [
            {"name": name, "offset": int(at), "datatype": POINT_FIELD_DATATYPES[f.str[1:]], "count": 1}
            for name, at, f in zip(columns, offsets[:-1], formats, strict=True)
        ],
        "is_bigendian": is_bigendian,
        "point_step": point_step,
        "row_step": width * point_step + row_padding,
        "data": np.pad(rows, ((0, 0), (0, row_padding))).reshape(-1),
        "is_dense": bool(np.isfinite(points).all()),
    }


def image(
    pixels: Array,
    *,
    stamp_ns: int,
    frame_id: str = "camera",
    encoding: str = "rgb8",
    row_padding: int = 0,
    is_bigendian: bool = False,
) -> Fields:
    """sensor_msgs/Image of the given array (H, W) or (H, W, C), bytes as they are."""
    height, width = pixels.shape[:2]
    rows = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8).reshape(height, -1)
    return {
        "header": header(stamp_ns, frame_id),
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": int(is_bigendian),
        "step": rows.shape[1] + row_padding,
        "data": np.pad(rows, ((0, 0), (0, row_padding))).reshape(-1),
    }


def camera_info(
    K: npt.ArrayLike,
    *,
    stamp_ns: int,
    width_px: int,
    height_px: int,
    frame_id: str = "camera",
    distortion_model: str = "plumb_bob",
    distortion: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
    R: npt.ArrayLike | None = None,
    P: npt.ArrayLike | None = None,
) -> Fields:
    """sensor_msgs/CameraInfo; without `P` the projection matrix is [K | 0]."""
    k = np.asarray(K, np.float64).reshape(3, 3)
    p = np.hstack([k, np.zeros((3, 1))]) if P is None else np.asarray(P, np.float64)
    return {
        "header": header(stamp_ns, frame_id),
        "height": height_px,
        "width": width_px,
        "distortion_model": distortion_model,
        "d": np.asarray(distortion, np.float64),
        "k": k.reshape(9),
        "r": (np.eye(3) if R is None else np.asarray(R, np.float64)).reshape(9),
        "p": p.reshape(12),
    }


def transform_stamped(
    parent: str,
    child: str,
    *,
    stamp_ns: int,
    translation: Sequence[float] = (0.0, 0.0, 0.0),
    rotation_xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
) -> Fields:
    """geometry_msgs/TransformStamped: pose of `child` in `parent`."""
    return {
        "header": header(stamp_ns, parent),
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", translation, strict=True)),
            "rotation": dict(zip("xyzw", rotation_xyzw, strict=True)),
        },
    }


def tf_message(transforms: Sequence[Fields]) -> Fields:
    """tf2_msgs/TFMessage of `transform_stamped` items."""
    return {"transforms": list(transforms)}


def odometry(
    *,
    stamp_ns: int,
    frame_id: str = "odom",
    child_frame_id: str = "base_link",
    position: Sequence[float] = (0.0, 0.0, 0.0),
    orientation_xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
) -> Fields:
    """nav_msgs/Odometry; twist and covariances are zero."""
    body = {"header": header(stamp_ns, frame_id), "child_frame_id": child_frame_id}
    return {**body, "pose": {"pose": pose(position, orientation_xyzw)}}


def pose(position: Sequence[float], xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Fields:
    """geometry_msgs/Pose."""
    numbers = {"position": zip("xyz", position, strict=True), "orientation": zip("xyzw", xyzw, strict=True)}
    return {name: {axis: float(value) for axis, value in axes} for name, axes in numbers.items()}


def box2d(left: float, top: float, right: float, bottom: float) -> Fields:
    """vision_msgs/BoundingBox2D."""
    center = {"position": {"x": float(left + right) / 2, "y": float(top + bottom) / 2}}
    return {"center": center, "size_x": float(right - left), "size_y": float(bottom - top)}


def detection2d_array(
    xyxy: npt.ArrayLike, *, class_names: Sequence[str], scores: Sequence[float], stamp_ns: int, frame_id: str = "camera"
) -> Fields:
    """vision_msgs/Detection2DArray of boxes left, top, right, bottom in pixels."""
    return {
        "header": header(stamp_ns, frame_id),
        "detections": [
            {
                "header": header(stamp_ns, frame_id),
                "results": [{"hypothesis": {"class_id": name, "score": float(score)}}],
                "bbox": box2d(*box),
            }
            for box, name, score in zip(np.asarray(xyxy, np.float64).reshape(-1, 4), class_names, scores, strict=True)
        ],
    }


# --- serialised


@lru_cache
def store_for(encoding: Encoding) -> Typestore:
    """Types of ROS 1 Noetic (`ros1`) or ROS 2 Humble (`cdr`), with vision_msgs and tf2_msgs."""
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    known = message_types(2).fielddefs
    store.register({n: known[n] for n in known if n.startswith(MORE_PACKAGES) and n not in store.fielddefs})
    return store


@lru_cache
def channel(topic: str, msgtype: str, encoding: Encoding = "cdr") -> Channel:
    """A channel with the full definition of its type."""
    return _channel_of(store_for(encoding), topic, msgtype, encoding)


def _channel_of(store: Typestore, topic: str, msgtype: str, encoding: Encoding) -> Channel:
    ros_version: Literal[1, 2] = 1 if encoding == "ros1" else 2
    text, _ = store.generate_msgdef(msgtype, ros_version=ros_version)
    return Channel(topic, msgtype, encoding, text, "ros1msg" if encoding == "ros1" else "ros2msg")


def serialize(msgtype: str, message: Fields, encoding: Encoding = "cdr", store: Typestore | None = None) -> bytes:
    """The bytes of a message mapping; `store` holds the types (default: `store_for(encoding)`)."""
    types = store_for(encoding) if store is None else store
    built = _build(types, msgtype, message)
    serialized = types.serialize_ros1 if encoding == "ros1" else types.serialize_cdr
    return bytes(serialized(built, msgtype))


def raw(
    topic: str,
    msgtype: str,
    message: Fields,
    stamp_ns: int,
    log_time_ns: int | None = None,
    encoding: Encoding = "cdr",
    *,
    order: tuple[int, ...] = (0, 0),
    store: Typestore | None = None,
) -> RawMessage:
    """An undecoded message as a reader yields it; recorded at its stamp unless `log_time_ns` says otherwise.

    `store` has the types where they are not those of `store_for`.
    """
    log_time_ns = stamp_ns if log_time_ns is None else log_time_ns
    source = channel(topic, msgtype, encoding) if store is None else _channel_of(store, topic, msgtype, encoding)
    return RawMessage(stamp_ns, log_time_ns, order, serialize(msgtype, message, encoding, store), source)


def _build(store: Typestore, msgtype: str, message: Fields) -> Any:
    values = {name.lower(): value for name, value in message.items()}
    definition = store.fielddefs[msgtype][1]
    arguments = {
        name: _field(store, node, detail, values.pop(name.lower(), None)) for name, (node, detail) in definition
    }
    if values:
        raise KeyError(f"{msgtype} has no field {', '.join(values)}")
    return store.types[msgtype](**arguments)


def _field(store: Typestore, node: Nodetype, detail: Any, value: Any) -> Any:
    if node == Nodetype.NAME:  # a mapping, or a message of a type that rosbags has made
        return _build(store, detail, value or {}) if value is None or isinstance(value, Mapping) else value
    if node == Nodetype.BASE:
        return value if value is not None else _zero(detail[0])
    (item_node, item_detail), length = detail
    if item_node == Nodetype.BASE and item_detail[0] not in {"string", "wstring"}:
        dtype = {"byte": "u1", "char": "u1", "octet": "u1"}.get(item_detail[0], item_detail[0])
        if value is None:
            return np.zeros(length if node == Nodetype.ARRAY else 0, dtype)
        return np.frombuffer(value, dtype) if isinstance(value, bytes) else np.asarray(value, dtype)
    items = [None] * (length if node == Nodetype.ARRAY else 0) if value is None else value
    return [_field(store, item_node, item_detail, item) for item in items]


def _zero(base: str) -> str | bool | int | float:
    if base in {"string", "wstring"}:
        return ""
    return False if base == "bool" else 0.0 if base.startswith("float") else 0


# --- recordings


def in_order(*parts: Iterable[RawMessage]) -> list[RawMessage]:
    """All messages by log time; those of one time by topic."""
    return sorted(chain(*parts), key=lambda message: (message.log_time_ns, message.topic))


def write_rosbag1(
    path: Path,
    raws: Iterable[RawMessage],
    compression: Literal["none", "bz2", "lz4"] = "none",
    *,
    chunk_bytes: int = 1 << 20,
) -> None:
    """A ROS 1 bag of `ros1` messages in the order given; one connection per channel."""
    writer = Writer1(path)
    writer.chunk_threshold = chunk_bytes
    if compression != "none":
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])

    def added(source: Channel) -> Any:
        _, md5sum = typestore_for(source).generate_msgdef(source.msgtype)
        return writer.add_connection(source.topic, source.msgtype, msgdef=source.definition, md5sum=md5sum)

    _write_all(writer, raws, added)


def write_rosbag2(
    path: Path,
    raws: Iterable[RawMessage],
    plugin: Literal["sqlite3", "mcap"] = "sqlite3",
    compression: Literal["none", "file", "message", "storage"] = "none",
    *,
    definitions: bool = True,
) -> None:
    """A ROS 2 bag folder of `cdr` messages in the order given; `storage` compresses MCAP chunks, all with zstd."""
    writer = Writer2(path, version=9, storage_plugin=StoragePlugin[plugin.upper()])
    writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)

    def added(source: Channel) -> Any:
        definition, rihs01 = source.definition if definitions else "", typestore_for(source).hash_rihs01(source.msgtype)
        return writer.add_connection(source.topic, source.msgtype, msgdef=definition, rihs01=rihs01)

    _write_all(writer, raws, added)


def write_recording(path: Path, kind: str, raws: Iterable[RawMessage], *, chunk_bytes: int = 1 << 20) -> Path:
    """A recording of a kind: `bag-lz4`, `mcap-zstd`, `loose` (an MCAP without chunks), `folder:sqlite3-file`."""
    form, _, how = kind.partition("-")
    compression: Any = how or "none"
    if form == "bag":
        write_rosbag1(path, raws, compression, chunk_bytes=chunk_bytes)
    elif form in {"mcap", "loose"}:
        write_mcap(path, raws, compression, chunk_bytes=chunk_bytes, use_chunking=form == "mcap")
    else:
        write_rosbag2(path, raws, "mcap" if form == "folder:mcap" else "sqlite3", compression)
    return path


def _write_all(writer: Any, raws: Iterable[RawMessage], added: Callable[[Channel], Any]) -> None:
    connections: dict[Channel, Any] = {}
    with writer:
        for message in raws:
            source = message.channel
            connections[source] = connections.get(source) or added(source)
            writer.write(connections[source], message.log_time_ns, message.data)


def write_mcap(
    path: Path,
    raws: Iterable[RawMessage],
    compression: Literal["none", "lz4", "zstd"] = "none",
    *,
    chunk_bytes: int = 1 << 20,
    profile: str | None = None,
    **options: bool,
) -> None:
    """One MCAP file by the mcap library, messages of any encoding; `options` go to its Writer (`use_chunking`...).

    Without `profile` it is that of the first message.
    """
    messages = iter(raws)
    first = next(messages, None)
    if profile is None:
        profile = "ros1" if first is not None and first.channel.encoding == "ros1" else "ros2"
    with path.open("xb") as stream:
        writer = McapWriter(stream, chunk_bytes, CompressionType[compression.upper()], **options)  # type: ignore[arg-type]  # bools only
        writer.start(profile, "lidcam tests")
        channels: dict[Channel, int] = {}
        for sequence, message in enumerate(chain([] if first is None else [first], messages)):
            source = message.channel
            if source not in channels:
                ros1 = source.encoding == "ros1"
                name = source.msgtype.replace("/msg/", "/") if ros1 else source.msgtype
                binary = source.definition_format == "protobuf"
                definition = b64decode(source.definition) if binary else source.definition.encode()
                schema = writer.register_schema(name, source.definition_format, definition)
                channels[source] = writer.register_channel(source.topic, source.encoding, schema)
            at_ns = message.log_time_ns
            writer.add_message(channels[source], at_ns, bytes(message.data), at_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part
