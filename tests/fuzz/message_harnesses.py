"""The decoders of single messages, see `harnesses`: for each a function of bytes, and inputs to begin with."""

import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import zstandard
from builders import (
    Fields,
    camera_info,
    channel,
    detection2d_array,
    header,
    image,
    odometry,
    pointcloud2,
    serialize,
    tf_message,
    transform_stamped,
)
from memory_recording import MemoryRecording
from object_messages import Recorded, autoware_message, autoware_object
from track_messages import track, track_array
from video import CODECS, compressed_video, encode, ffmpeg_packet, moving

from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.rig import RecordedDetector, Rig
from lidcam.pipeline.core.ros.typestores import message_types
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.pipeline.stages.detect3d import Recorded3D
from lidcam.readers.messages.camera_info import camera_model, rectified_camera_model
from lidcam.readers.messages.compressed_cloud import decode_compressed_cloud
from lidcam.readers.messages.deserialize import definition_problem, deserialize, typestore_for
from lidcam.readers.messages.detections import decode_detections2d, decode_detections3d
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.objects import ObjectClasses, decode_tracks
from lidcam.readers.messages.pointcloud import decode_livox, decode_pointcloud
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.messages.tf import decode_odometry, decode_transforms, read_transforms
from lidcam.readers.messages.to_ros2 import to_ros2
from lidcam.readers.results.result import decode_diagnostics
from lidcam.readers.streams.recorded3d import RecordedBoxes3D
from lidcam.readers.velodyne.decoder import VelodyneDecoders
from lidcam.readers.velodyne.models import MODELS
from lidcam.readers.video.decoder import VideoDecoder

T0 = 1_700_000_000 * 10**9
Encoding = Literal["ros1", "cdr"]
ENCODINGS: tuple[Encoding, ...] = ("ros1", "cdr")

LIMITS = RecordingLimits(
    max_unpacked_file_gib=0.05,
    max_chunk_bytes=4 << 20,
    max_message_bytes=2 << 20,
    max_messages_per_chunk=2000,
    max_messages_in_memory=10_000,
    max_positions_waiting=10_000,
    max_topics=20,
    max_points=100_000,
    max_image_mpx=1.0,
    max_losses_listed=50,
)
"""Small, so that a few kilobytes are enough to come to them."""

CONFIG = Config(limit_scale=0.01)

MAX_LINE_CHARACTERS = 5000


class Harness(NamedTuple):
    """One decoder."""

    run: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]


def hold(decode: Callable[..., Any], *arguments: Any) -> None:
    """Run a decoder, and hold what leaves it to the contract."""
    try:
        decode(*arguments)
    except LidcamError as err:
        text = str(err)
        if not text or "\n" in text or len(text) > MAX_LINE_CHARACTERS:
            raise AssertionError(f"an error in one short line was expected, found {text[:200]!r}") from err


def _of_messages(msgtype: str, decode: Callable[[RawMessage], Any], fields: Callable[[], list[Fields]]) -> Harness:
    """A decoder of messages; the first byte says the encoding."""

    def run(data: bytes) -> None:
        encoding = ENCODINGS[data[0] & 1 if data else 0]
        hold(decode, RawMessage(T0, T0, (0, 0), data[1:], channel("/topic", msgtype, encoding)))

    def seeds() -> list[bytes]:
        serialized = [(number, one, encoding) for one in fields() for number, encoding in enumerate(ENCODINGS)]
        return [bytes([number]) + serialize(msgtype, one, encoding) for number, one, encoding in serialized]

    return Harness(run, seeds)


def _limited(msgtype: str, decode: Callable[..., Any], fields: Callable[[], list[Fields]]) -> Harness:
    """A decoder of messages that heeds limits."""
    return _of_messages(msgtype, partial(decode, limits=LIMITS), fields)


OBJECTS = "vision_msgs/msg/Detection3DArray"


def _clouds() -> list[Fields]:
    points = np.arange(9, dtype=np.float32).reshape(-1, 3)
    times = np.linspace(0, 0.1, 3)
    return [
        pointcloud2(points, stamp_ns=T0, ring=np.arange(3, dtype=np.uint16), time=times.astype(np.float32)),
        pointcloud2(points.astype(np.float64), stamp_ns=T0, is_bigendian=True, timestamp=T0 / 1e9 + times),
    ]


def images() -> list[Fields]:
    rng = np.random.default_rng(0)
    names = ("rgb8", "mono16", "bayer_rggb8", "uyvy", "nv12", "nv24")
    shapes = ((4, 4, 3), (4, 8), (4, 4), (4, 8), (6, 4), (12, 4))
    return [
        {**image(rng.integers(0, 256, shape, np.uint8), stamp_ns=T0, encoding=name), "width": 4, "height": 4}
        for name, shape in zip(names, shapes, strict=True)
    ]


def _compressed() -> list[Fields]:
    pixels = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    names = {
        "bgr8; tiff compressed bgr8": "tiff",
        "bayer_rggb8; png compressed": "bmp",
        "rgb8; png compressed bgr8": "png",
    }
    names |= {kind: kind for kind in ("jpeg", "webp", "avif")}
    return [
        {"header": header(T0, "camera"), "format": kind, "data": cv2.imencode(f".{suffix}", pixels)[1].reshape(-1)}
        for kind, suffix in names.items()
    ]


def _decode_info(message: RawMessage) -> None:
    info = deserialize(message)
    with suppress(LidcamError):
        camera_model(info)
    rectified_camera_model(info)


def _objects(data: bytes) -> None:
    """Objects in the layouts of ROS 1, with numbers as classes and clouds, and of ROS 2."""
    version: Literal[1, 2] = 1 if data and data[0] & 1 else 2
    encoding, form = ("ros1", "ros1msg") if version == 1 else ("cdr", "ros2msg")
    definition, _ = message_types(version).generate_msgdef(OBJECTS, ros_version=version)
    channel = Channel("/objects", OBJECTS, encoding, definition, form)  # type: ignore[arg-type]  # of these words
    message = RawMessage(T0, T0, (0, 0), data[1:], channel)
    hold(partial(decode_detections3d, limits=LIMITS), message)
    _detected(message)


def _detected_objects(data: bytes) -> None:
    """Objects of Autoware."""
    _detected(autoware_message(T0, [], topic="/objects")._replace(data=data))


def _detected(message: RawMessage) -> None:
    """The boxes of a detector, up to those of the frame."""
    site = {name: Transform.identity("site", name) for name in ("site", "a")}
    rig = Rig("site", (), (), (), detectors=(RecordedDetector("objects", "/objects", "site", site),))
    bundle = SensorBundle(0, T0, T0, {"/objects": message})
    hold(lambda one: Recorded3D(rig)(one, RecordedBoxes3D(rig, CONFIG, on_bad="fail")(one)), bundle)


def _detected_seeds() -> list[bytes]:
    one = Recorded((1.0, 2.0, 3.0), covariance=np.eye(6))
    polygon = autoware_object(one, type=2, footprint={"points": [{"x": 1.0, "y": 2.0}, {"x": -1.0, "y": -2.0}]})
    lists: list[list[Fields]] = [
        [],
        [autoware_object(one)],
        [polygon, autoware_object(one, orientation_availability=0)],
    ]
    return [bytes(autoware_message(T0, objects).data) for objects in lists]


def _object_seeds() -> list[bytes]:
    box = {"center": {"position": {"x": 1.0}, "orientation": {"w": 1.0}}, "size": {"x": 4.0, "y": 2.0, "z": 1.5}}
    numbers = [{"id": 1, "score": 1.0}, {"id": -1, "score": 9.0}]
    of_ros1 = {"results": numbers, "bbox": box, "source_cloud": _clouds()[0]}
    of_ros2 = {"results": [{"hypothesis": {"class_id": name}} for name in ("car", "lidar_points")], "bbox": box}
    seeds = []
    for count in (0, 1, 3):
        head = {"header": header(T0, "site")}
        ros1, ros2 = {**head, "detections": [of_ros1] * count}, {**head, "detections": [of_ros2] * count}
        seeds += [b"\1" + serialize(OBJECTS, ros1, "ros1", message_types(1)), b"\0" + serialize(OBJECTS, ros2)]
    return seeds


EDGES = ("a", "b"), ("b", "c")


def _decode_tf(message: RawMessage) -> None:
    list(decode_transforms(message))
    transforms = read_transforms(MemoryRecording([message]))
    transforms.lookup("a", "c")


def _scans() -> list[Fields]:
    rng = np.random.default_rng(0)
    messages: list[Fields] = []
    for model in (MODELS["VLP-16"], MODELS["VLP-32C"], MODELS["HDL-32E"], MODELS["VLS-128"]):
        payload = rng.integers(0, 256, (2, 1206), np.uint8)
        payload[:, 0:1200:100], payload[:, 1:1200:100] = 0xFF, 0xEE
        payload[:, 1204], payload[:, 1205] = 0x37, model.product or 0
        packets = [{"stamp": {"sec": 1_700_000_000, "nanosec": 0}, "data": data} for data in payload]
        messages.append({"header": header(T0, "velodyne"), "packets": packets})
    return messages


ROS1_DEFINITION = "Header header\nPart[2] parts\nstring name\nuint8 A=1\n" + "=" * 80
DEFINITIONS = [
    ROS1_DEFINITION + "\nMSG: a/Part\nfloat64[] x\nint32[3] y\n",
    "a/msg/B b\n" + "=" * 80 + "\nMSG: a/msg/B\na/msg/A a\n",
    "a/msg/A[] children",
    "string<=10[<=3] names\nwstring w 'x'\nint32 N=-3\ngeometry_msgs/Pose[2] poses\n",
    "\n".join(f"float64 x{i}" for i in range(300)),
    "uint8[99999999999] x\nstring[1000000] y",
    "Empty[] nothing\n" + "=" * 80 + "\nMSG: a/Empty\n",
]
IDL = """================================================================================
IDL: a/msg/A
module a { module msg { module A_Constants { const uint8 N = 1; };
@verbatim (language="comment", text="words" "and more")
struct A { std_msgs::msg::Header header; double x[3]; sequence<a::msg::B, 4> parts; string name; }; }; };
================================================================================
IDL: a/msg/B
module a { module msg { struct B { int32 number; }; }; };
"""
Form = Literal["ros1msg", "ros2msg", "ros2idl"]
FORMATS: tuple[tuple[Encoding, Form], ...] = ("ros1", "ros1msg"), ("cdr", "ros2msg"), ("cdr", "ros2idl")


def _definition(data: bytes) -> None:
    """A message definition in one of three forms, and two messages of that type."""
    encoding, form = FORMATS[data[0] % 3 if data else 0]
    digest = "0" * 32 if encoding == "ros1" else "RIHS01_0"
    source = Channel("/topic", "a/msg/A", encoding, data[1:].decode(errors="replace"), form, "humble", digest)
    definition_problem(source)
    for content in (bytes(400), bytes([0, 1, 0, 0, *b"\2\0\0\0" * 40])):
        hold(deserialize, RawMessage(T0, T0, (0, 0), content, source))
    hold(lambda: typestore_for(source).hash_rihs01("a/msg/A"))


def _definition_seeds() -> list[bytes]:
    return [bytes([form]) + text.encode() for text in DEFINITIONS for form in (0, 1)] + [b"\2" + IDL.encode()]


def _video(data: bytes) -> None:
    """Packets behind their lengths; the first byte says the codec and the type of the messages."""
    kinds = [*CODECS]
    form, is_ffmpeg = kinds[data[0] % len(kinds)] if data else "h264", bool(data) and data[0] >= 128
    decoder, rest, count, shown = VideoDecoder("/camera", limits=LIMITS), data[1:], 0, 0
    while len(rest) > 1:
        length = int.from_bytes(rest[:2], "big")
        packet, stamp_ns = rest[2 : 2 + length], T0 + count
        message = (
            ffmpeg_packet(packet, stamp_ns, name=form) if is_ffmpeg else compressed_video(packet, stamp_ns, form=form)
        )
        count, rest = count + 1, rest[2 + length :]
        shown += len(decoder.add_message(message, show=count % 8 > 0)) + (count % 8 == 0)
    if shown + len(decoder.flush()) != count:
        raise AssertionError(f"{count} messages went in, {shown} came out")


def _video_seeds() -> list[bytes]:
    seeds = []
    for number, kind in enumerate(CODECS):
        packets = [packet.data for packet in encode(moving(4, 32, 32), kind, gop=2)]
        body = b"".join(len(packet).to_bytes(2, "big") + packet for packet in packets)
        seeds += [bytes([first]) + body for first in (number, 128 + (number - 128) % len(CODECS))]
    return seeds


def info() -> Fields:
    return camera_info(np.diag([5.0, 5.0, 1.0]), stamp_ns=T0, width_px=4, height_px=4)


def _tree(*edges: tuple[str, str]) -> Fields:
    return tf_message([transform_stamped(*edge, stamp_ns=T0) for edge in edges])


def _boxes() -> Fields:
    return detection2d_array([[0, 0, 5, 5]] * 2, class_names=["car", "0"], scores=[0.5, 0.6], stamp_ns=T0)


def _compressed_clouds() -> list[Fields]:
    plain = dict(_clouds()[0])
    data = plain.pop("data").tobytes()
    packed = {"zlib": zlib.compress(data), "zstd": zstandard.compress(data), "draco": b"DRACO\2\3" + bytes(40)}
    return [{**plain, "format": name, "compressed_data": np.frombuffer(one, np.uint8)} for name, one in packed.items()]


def _old_cloud() -> Fields:
    channels = [{"name": "intensity", "values": np.ones(2, np.float32)}]
    return {"header": header(T0, "laser"), "points": [{"x": 1.0}, {"y": 1.0}], "channels": channels}


def _livox(count: int) -> Fields:
    points = [{"offset_time": 1000 * index, "x": 1.0 * index, "line": index} for index in range(count)]
    return {"header": header(T0, "livox"), "timebase": T0, "point_num": count, "points": points}


def _status() -> Fields:
    return {"status": [{"name": "a", "values": [{"key": "skew_ms", "value": "1.5"}]}]}


def _tracks(data: bytes) -> None:
    hold(partial(decode_tracks, limits=LIMITS), track_array([], stamp_ns=T0)._replace(data=data))


def _track_seeds() -> list[bytes]:
    return [bytes(track_array(tracks, stamp_ns=T0).data) for tracks in ([], [track(1), track(2, (1.0, 2.0), 3.0)])]


MESSAGES: dict[str, Harness] = {
    "pointcloud2": _limited("sensor_msgs/msg/PointCloud2", decode_pointcloud2, _clouds),
    "pointcloud": _limited("sensor_msgs/msg/PointCloud", decode_pointcloud, lambda: [_old_cloud()]),
    "compressed_cloud": _limited(
        "point_cloud_interfaces/msg/CompressedPointCloud2", decode_compressed_cloud, _compressed_clouds
    ),
    "livox": _limited("livox_ros_driver/msg/CustomMsg", decode_livox, lambda: [_livox(0), _livox(3)]),
    "image": _limited("sensor_msgs/msg/Image", decode_any_image, images),
    "compressed_image": _limited("sensor_msgs/msg/CompressedImage", decode_any_image, _compressed),
    "camera_info": _of_messages("sensor_msgs/msg/CameraInfo", _decode_info, lambda: [info()]),
    "tf": _of_messages("tf2_msgs/msg/TFMessage", _decode_tf, lambda: [_tree(*EDGES), _tree(*EDGES, ("c", "a"))]),
    "odometry": _of_messages("nav_msgs/msg/Odometry", decode_odometry, lambda: [odometry(stamp_ns=T0)]),
    "to_ros2": _of_messages("nav_msgs/msg/Odometry", to_ros2, lambda: [odometry(stamp_ns=T0)]),
    "detections2d": _of_messages(
        "vision_msgs/msg/Detection2DArray",
        lambda m: decode_detections2d(m, ObjectClasses({"car": 0}, "coco")),
        lambda: [_boxes()],
    ),
    "detections3d": Harness(_objects, _object_seeds),
    "detected_objects": Harness(_detected_objects, _detected_seeds),
    "diagnostics": _limited("diagnostic_msgs/msg/DiagnosticArray", decode_diagnostics, lambda: [_status()]),
    "tracks": Harness(_tracks, _track_seeds),
    "velodyne_scan": _of_messages(
        "velodyne_msgs/msg/VelodyneScan", lambda m: VelodyneDecoders(Config().velodyne)[m.topic](m), _scans
    ),
    "video": Harness(_video, _video_seeds),
    "definition": Harness(_definition, _definition_seeds),
}
"""By name."""
