"""What is fuzzed: for every decoder a function of bytes, and inputs to begin with.

The contract of each: whatever the bytes, nothing but a `LidcamError` leaves lidcam's readers, its text is one short
line, and memory and time stay bounded. A new decoder gets a line in `HARNESSES`, and what was found a file in
`corpus/NAME/`.
"""

import json
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import yaml
from builders import (
    Fields,
    camera_info,
    channel,
    detection2d_array,
    header,
    image,
    odometry,
    pointcloud2,
    raw,
    serialize,
    tf_message,
    transform_stamped,
)
from combined_messages import CAMERAS, combined
from foxglove_messages import SCHEMA_OF, foxglove_raw, twin
from frames import PROVENANCE, frame
from frames import RIG as FRAMES_RIG
from memory_recording import MemoryRecording
from object_messages import Recorded, autoware_message, autoware_object
from video import CODECS, compressed_video, encode, ffmpeg_packet, moving

from lidcam.evaluation.frames import EvaluationFrames
from pipeline.core.errors import LidcamError
from pipeline.core.frame import FrameResult, SensorBundle
from pipeline.core.geometry.transform import Transform
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.rig import LidarSensor, RecordedDetector, Rig
from pipeline.core.ros.typestores import message_types
from pipeline.core.settings.config import Config
from pipeline.core.settings.load import dump_config, load_config
from pipeline.core.settings.recording import LimitsConfig
from pipeline.stages.detect3d import Recorded3D
from readers.files.rosbag2_folder import recording_files
from readers.messages.camera_info import camera_model, rectified_camera_model
from readers.messages.deserialize import definition_problem, deserialize, typestore_for
from readers.messages.diagnostics import decode_diagnostics
from readers.messages.image import decode_any_image
from readers.messages.odometry import decode_odometry
from readers.messages.pointcloud2 import decode_pointcloud2
from readers.messages.tf import decode_transforms, read_transforms
from readers.messages.to_ros2 import to_ros2
from readers.messages.vision.detections2d import decode_detections2d
from readers.messages.vision.detections3d import decode_detections3d
from readers.open import open_recording
from readers.recording import ReadOptions, Recording
from readers.results.result import open_result
from readers.rig.discovery import discover_rig
from readers.rig.rig_file import load_rig, rig_yaml
from readers.streams.motion import find_motion_source
from readers.streams.per_sensor import sensor_messages
from readers.streams.recorded3d import RecordedBoxes3D
from readers.streams.survey import survey
from readers.truth.kitti import KittiTruth
from readers.truth.open import open_truth
from readers.truth.openlabel import OpenLabelTruth
from readers.truth.predecessor import PredecessorTruth
from readers.velodyne.calibration import read_velodyne_calibration
from readers.velodyne.decoder import VelodyneDecoders
from readers.velodyne.models import MODELS
from readers.video.decoder import VideoDecoder
from writers.mcap.writer import McapResultWriter
from writers.outputs.transaction import OutputFile

__all__ = ["HARNESSES", "Harness"]

T0 = 1_700_000_000 * 10**9
Encoding = Literal["ros1", "cdr"]
ENCODINGS: tuple[Encoding, ...] = ("ros1", "cdr")

LIMITS = LimitsConfig(
    max_unpacked_file_gib=0.05,
    max_chunk_mib=4,
    max_message_mib=2,
    max_messages_per_chunk=2000,
    max_messages_in_memory=10_000,
    max_positions_waiting=10_000,
    max_topics=20,
    max_points=100_000,
    max_image_mpx=1.0,
    max_losses_listed=50,
)
"""Small, so that a few kilobytes are enough to come to them."""

MAX_MESSAGES = 3000
MAX_LINE_CHARACTERS = 5000


class Harness(NamedTuple):
    """One decoder.

    Attributes:
        run: Gives it the bytes; raises whatever breaks the contract.
        seeds: Sound inputs, and hostile ones that are known.
    """

    run: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]


def _hold(decode: Callable[..., Any], *arguments: Any) -> None:
    """Run a decoder, and hold what leaves it to the contract."""
    try:
        decode(*arguments)
    except LidcamError as err:
        text = str(err)
        if not text or "\n" in text or len(text) > MAX_LINE_CHARACTERS:
            raise AssertionError(f"an error in one short line was expected, found {text[:200]!r}") from err


# --- recordings


@cache
def _folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="lidcam-fuzz-")


def _file(name: str, data: bytes) -> Path:
    path = Path(_folder().name) / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    return path


def _read_everything(recording: Recording) -> None:
    with sensor_messages(recording) as opened:
        for message in islice(opened.messages(), MAX_MESSAGES):
            with suppress(LidcamError):
                deserialize(message)
        survey(opened)
        for loss in opened.losses:
            if loss.position < 0 or "\n" in loss.reason:
                raise AssertionError(f"a loss that cannot be told: {loss}")
        with suppress(LidcamError):
            found = discover_rig(opened, Config(limits=LIMITS))
            find_motion_source(opened, found.rig, found.transforms, Config(limits=LIMITS))


def _scene(encoding: Encoding) -> list[RawMessage]:
    """One message of every kind."""
    points = np.arange(12, dtype=np.float32).reshape(-1, 3)
    fields: dict[str, tuple[str, Fields]] = {
        "/points": ("sensor_msgs/msg/PointCloud2", pointcloud2(points, stamp_ns=T0, intensity=points[:, 0])),
        "/camera/image_raw": ("sensor_msgs/msg/Image", image(np.zeros((4, 4, 3), np.uint8), stamp_ns=T0)),
        "/camera/camera_info": (
            "sensor_msgs/msg/CameraInfo",
            camera_info(np.diag([5.0, 5.0, 1.0]), stamp_ns=T0, width_px=4, height_px=4),
        ),
        "/tf_static": ("tf2_msgs/msg/TFMessage", tf_message([transform_stamped("lidar", "camera", stamp_ns=T0)])),
        "/odom": ("nav_msgs/msg/Odometry", odometry(stamp_ns=T0)),
    }
    return [
        raw(topic, msgtype, message, T0 + i, T0 + i, encoding)
        for i, (topic, (msgtype, message)) in enumerate(fields.items())
    ]


def _written(name: str, write: Callable[[Path], None]) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes() if path.is_file() else next(path.glob("*.[dm][bc]*")).read_bytes()


def _result(data: bytes) -> None:
    _hold(_read_result, _file("out.mcap", data))


def _read_result(path: Path) -> None:
    with open_result(path, options=ReadOptions(limits=LIMITS)) as result, open_truth(result) as truth:
        frames = EvaluationFrames(result, truth)
        for _ in islice(frames, MAX_MESSAGES):
            pass
        if any("\n" in note for note in frames.notes):
            raise AssertionError(f"notes of one line each were expected, found {frames.notes}")


def _result_seeds() -> list[bytes]:
    frames = [frame(index, motion=True) for index in range(2)]
    return [
        _written("out.mcap", partial(_write_result, frames=[])),
        _written("out.mcap", partial(_write_result, frames=frames)),
    ]


def _write_result(path: Path, frames: Sequence[FrameResult]) -> None:
    config = load_config(settings=["output.clouds=false", "output.images=false", "output.compression=none"])
    provenance = replace(PROVENANCE, config_yaml=dump_config(config), rig_yaml=rig_yaml(FRAMES_RIG))
    with McapResultWriter(OutputFile(path, path), FRAMES_RIG, config, provenance) as writer:
        for one in frames:
            writer.write(one)


# --- messages


def _messages(msgtype: str, decode: Callable[[RawMessage], Any]) -> Callable[[bytes], None]:
    """Bytes of a message; the first says the encoding."""

    def run(data: bytes) -> None:
        encoding = ENCODINGS[data[0] & 1 if data else 0]
        message = RawMessage(T0, T0, (0, 0), data[1:], channel("/topic", msgtype, encoding))
        _hold(decode, message)

    return run


def _message_seeds(msgtype: str, *messages: Fields) -> Callable[[], list[bytes]]:
    return lambda: [
        bytes([number]) + serialize(msgtype, message, encoding)
        for message in messages
        for number, encoding in enumerate(ENCODINGS)
    ]


CLOUD, IMAGE, COMPRESSED, INFO, TF, ODOMETRY, BOXES, OBJECTS, STATUS, SCAN = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "tf2_msgs/msg/TFMessage",
    "nav_msgs/msg/Odometry",
    "vision_msgs/msg/Detection2DArray",
    "vision_msgs/msg/Detection3DArray",
    "diagnostic_msgs/msg/DiagnosticArray",
    "velodyne_msgs/msg/VelodyneScan",
)


def _clouds() -> list[Fields]:
    points = np.arange(9, dtype=np.float32).reshape(-1, 3)
    times = np.linspace(0, 0.1, 3)
    return [
        pointcloud2(points, stamp_ns=T0, ring=np.arange(3, dtype=np.uint16), time=times.astype(np.float32)),
        pointcloud2(points.astype(np.float64), stamp_ns=T0, is_bigendian=True, timestamp=T0 / 1e9 + times),
    ]


def _images() -> list[Fields]:
    rng = np.random.default_rng(0)
    names = ("rgb8", "mono16", "bayer_rggb8", "uyvy", "nv12", "nv24")
    shapes = ((4, 4, 3), (4, 8), (4, 4), (4, 8), (6, 4), (12, 4))
    images = [
        dict(image(rng.integers(0, 256, shape, np.uint8), stamp_ns=T0, encoding=name))
        for name, shape in zip(names, shapes, strict=True)
    ]
    return [{**image, "width": 4, "height": 4} for image in images]


def _compressed() -> list[Fields]:
    pixels = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    kinds = [".jpg", ".png", ".webp", ".bmp", ".avif", ".tiff"]
    formats = [
        "jpeg",
        "rgb8; png compressed bgr8",
        "webp",
        "bayer_rggb8; png compressed",
        "avif",
        "bgr8; tiff compressed bgr8",
    ]
    return [
        {"header": header(T0, "camera"), "format": kind, "data": cv2.imencode(suffix, pixels)[1].reshape(-1)}
        for suffix, kind in zip(kinds, formats, strict=True)
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
    _hold(lambda message: decode_detections3d(message, limits=LIMITS), message)
    _detected(message)


def _detected_objects(data: bytes) -> None:
    """Objects of Autoware."""
    source = autoware_message(T0, [], topic="/objects")
    _detected(source._replace(data=data))


def _detected(message: RawMessage) -> None:
    """The boxes of a detector, up to those of the frame."""
    site = {name: Transform.identity("site", name) for name in ("site", "a")}
    rig = Rig("site", (), (), (), detectors=(RecordedDetector("objects", "/objects", "site", site),))
    config = Config(limits=LIMITS)
    bundle = SensorBundle(0, T0, T0, {"/objects": message})
    _hold(lambda one: Recorded3D(rig)(one, RecordedBoxes3D(rig, config, on_bad="fail")(one)), bundle)


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
    of_ros1 = {
        "results": [{"id": 1, "score": 1.0}, {"id": -1, "score": 9.0}],
        "bbox": box,
        "source_cloud": _clouds()[0],
    }
    of_ros2 = {"results": [{"hypothesis": {"class_id": name}} for name in ("car", "lidar_points")], "bbox": box}
    seeds = []
    for count in (0, 1, 3):
        head = {"header": header(T0, "site")}
        ros1, ros2 = {**head, "detections": [of_ros1] * count}, {**head, "detections": [of_ros2] * count}
        seeds += [b"\1" + serialize(OBJECTS, ros1, "ros1", message_types(1)), b"\0" + serialize(OBJECTS, ros2)]
    return seeds


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


def _combined(data: bytes) -> None:
    """A combined message, taken apart."""
    for encoding in ENCODINGS[data[0] & 1 : (data[0] & 1) + 1] if data else ():
        whole = _combined_message(encoding)._replace(data=data[1:])
        _hold(_read_everything, MemoryRecording([whole, _combined_message(encoding)]))


@cache
def _combined_message(encoding: Encoding) -> RawMessage:
    images = [raw("/a", IMAGE, image, T0, encoding=encoding) for image in _images()[:2]]
    return combined("/all", CAMERAS, images, T0, encoding)


def _whole_scene(data: bytes) -> None:
    """A recording whose messages are altered: the calibration is looked for in it."""
    messages = _scene("cdr")
    for begin in range(0, len(data) - 3, 4):
        number, place, value = struct.unpack_from("<BHB", data, begin)
        message = messages[number % len(messages)]
        altered = bytearray(message.data)
        altered[place % len(altered)] = value
        messages[number % len(messages)] = message._replace(data=bytes(altered))
    _hold(_read_everything, MemoryRecording(messages))


# --- Foxglove


def _foxglove(encoding: Literal["protobuf", "json"]) -> Callable[[bytes], None]:
    schemas = sorted({*SCHEMA_OF.values(), "foxglove.FrameTransform"})

    def run(data: bytes) -> None:
        schema = schemas[data[0] % len(schemas) if data else 0]
        message = foxglove_raw("/topic", schema, {}, T0, encoding)._replace(data=data[1:])
        _hold(_read_everything, MemoryRecording([message]))

    return run


def _foxglove_seeds(encoding: Literal["protobuf", "json"]) -> Callable[[], list[bytes]]:
    schemas = sorted({*SCHEMA_OF.values(), "foxglove.FrameTransform"})

    def seeds() -> list[bytes]:
        twins = [twin(message, encoding) for message in _scene("cdr") if message.channel.msgtype in SCHEMA_OF]
        return [bytes([schemas.index(message.channel.msgtype)]) + bytes(message.data) for message in twins]

    return seeds


def _protobuf_schema(data: bytes) -> None:
    """The description of a protobuf type, then one message of that type."""
    from base64 import b64encode

    source = foxglove_raw("/topic", "foxglove.PointCloud", {}, T0)
    altered = Channel("/topic", source.channel.msgtype, "protobuf", b64encode(data).decode(), "protobuf")
    message = twin(_scene("cdr")[0], "protobuf")._replace(channel=altered)
    _hold(_read_everything, MemoryRecording([message]))


def _protobuf_schema_seeds() -> list[bytes]:
    from base64 import b64decode

    return [b64decode(foxglove_raw("/topic", "foxglove.PointCloud", {}, T0).channel.definition)]


# --- message definitions

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
FORMATS: tuple[tuple[Encoding, Literal["ros1msg", "ros2msg", "ros2idl"]], ...] = (
    ("ros1", "ros1msg"),
    ("cdr", "ros2msg"),
    ("cdr", "ros2idl"),
)


def _definition(data: bytes) -> None:
    """A message definition in one of three forms, and two messages of that type."""
    encoding, form = FORMATS[data[0] % 3 if data else 0]
    digest = "0" * 32 if encoding == "ros1" else "RIHS01_0"
    source = Channel("/topic", "a/msg/A", encoding, data[1:].decode(errors="replace"), form, "humble", digest)
    definition_problem(source)
    for content in (bytes(400), bytes([0, 1, 0, 0, *b"\2\0\0\0" * 40])):
        _hold(deserialize, RawMessage(T0, T0, (0, 0), content, source))
    _hold(_hash, source)


def _hash(source: Channel) -> None:
    typestore_for(source).hash_rihs01("a/msg/A")


def _definition_seeds() -> list[bytes]:
    return [bytes([form]) + text.encode() for text in DEFINITIONS for form in (0, 1)] + [b"\2" + IDL.encode()]


# --- texts


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
        shown += len(decoder.add(message, show=count % 8 > 0)) + (count % 8 == 0)
    if shown + len(decoder.flush()) != count:
        raise AssertionError(f"{count} messages went in, {shown} came out")


def _video_seeds() -> list[bytes]:
    seeds = []
    for number, kind in enumerate(CODECS):
        packets = [packet.data for packet in encode(moving(4, 32, 32), kind, gop=2)]
        body = b"".join(len(packet).to_bytes(2, "big") + packet for packet in packets)
        seeds += [bytes([first]) + body for first in (number, 128 + (number - 128) % len(CODECS))]
    return seeds


def _text(name: str, read: Callable[[Path], Any]) -> Callable[[bytes], None]:
    return lambda data: _hold(read, _file(name, data))


def _use_rig(path: Path) -> None:
    discover_rig(MemoryRecording(_scene("cdr")), Config(limits=LIMITS), load_rig(path))


def _use_folder(path: Path) -> None:
    folder = path.parent
    (folder / "a_0.db3").touch()
    for file in recording_files(folder):
        if file.resolve().parent != folder.resolve():
            raise AssertionError(f"{file} is not in the folder")


def _use_kitti_labels(path: Path) -> None:
    calibration = path.parents[1] / "calib" / path.name
    calibration.parent.mkdir(exist_ok=True)
    calibration.write_text(KITTI)
    truth = KittiTruth(path, LABELLED, Config())
    truth.at(T0, frame=0)
    truth.in_image("camera", T0, frame=0)


def _use_evaluation_folder(path: Path) -> None:
    _read_everything(open_recording([path.parents[1]], ReadOptions(limits=LIMITS)))


LABELLED = Rig("lidar", (LidarSensor("lidar", "/points", Transform.identity("lidar", "lidar")),), (), ())
KITTI_LABELS = "Car 0.10 1 -1.57 500.0 150.0 600.0 220.0 1.50 1.80 4.20 2.0 1.6 20.0 -1.57"
OPENLABEL = json.dumps(
    {
        "openlabel": {
            "coordinate_systems": {"lidar": {"parent": "", "pose_wrt_parent": {"quaternion": [0, 0, 0, 1]}}},
            "frames": {
                "0": {
                    "frame_properties": {"timestamp": T0},
                    "objects": {
                        "a": {"object_data": {"type": "car", "cuboid": {"val": [1, 2, 3, 0, 0, 0, 1, 4, 2, 1]}}}
                    },
                }
            },
        }
    }
)
RIG = """site_frame: lidar
lidars: {lidar: {topic: /points, T_site_lidar: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]}}
cameras:
  camera: {topic: /camera/image_raw, width_px: 4, height_px: 4, K: [5, 0, 2, 0, 5, 2, 0, 0, 1], distortion: [0.1, 0],
    translation_m: [0, 0, 1], rpy_deg: [0, 0, 90]}
zones: {all: [[0, 0], [10, 0], [10, 10]], yard: {corners: [[0, 0], [1, 0], [1, 1]], use: ignore}}
"""
GEOMETRY = """cameras:
  11: {w2c: [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], c2p: [[5, 0, 2, 0], [0, 5, 2, 0], [0, 0, 1, 0]]}
"""
KITTI = """P2: 7 0 6 4 0 7 1 2 0 0 1 0.002
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
S_rect_02: 1242 375
"""
CALIB_TXT = " ".join(["1.1e+01", "0 1 0 -0.3 -1 0 0 -0.1 0 0 1 -0.4 0 0 0 1", "5 0 2 0 0 5 2 0 0 0 1 0"]) + "\n"
CAMCHAIN = """cam0: {camera_model: pinhole, intrinsics: [5, 5, 2, 2], distortion_model: radtan,
  distortion_coeffs: [0, 0, 0, 0], resolution: [4, 4], rostopic: /camera/image_raw,
  T_cam_imu: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
cam1: {camera_model: omni, intrinsics: [1, 5, 5, 2, 2],
  T_cn_cnm1: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
"""
SENSOR_KIT = """base_link:
  camera0/camera_link: {x: 0.1, y: 0.5, z: -0.3, roll: -0.02, pitch: 0.3, yaw: 1.0}
  lidar: {x: 0, y: 0, z: 2, roll: 0, pitch: 0, yaw: 0}
"""
TO_DO = """site_frame: lidar
cameras: {camera: {topic: /camera/image_raw, K: TODO, T_camera_site: TODO, parent: lidar}}
transforms: {lidar: {imu: {rpy_deg: [0, 0, 90]}}}
"""
ALIASES = "a: &a [1, 1, 1]\n" + "\n".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join([f'*{chr(97 + i)}'] * 9)}]" for i in range(12)
)
MERGES = "a: &a {x: 1, y: 2}\n" + "\n".join(
    f"{chr(98 + i)}: &{chr(98 + i)}\n  <<: [{', '.join([f'*{chr(97 + i)}'] * 9)}]" for i in range(9)
)
HOSTILE_YAML = [
    ALIASES,
    MERGES,
    "a: &a [*a]",
    "[" * 3000,
    "a: 2001-99-99",
    f"a: {'9' * 5000}",
    "a: 1e99999",
    "? [a]\n: b",
]
METADATA = """rosbag2_bagfile_information:
  relative_file_paths: [a_0.db3, ../../etc/passwd, /etc/passwd, .., '', "a\\0b"]
  ros_distro: humble
  compression_mode: ''
"""


def _texts(*texts: str) -> Callable[[], list[bytes]]:
    return lambda: [text.encode() for text in (*texts, *HOSTILE_YAML)]


def _calibration() -> str:
    lasers = [{"laser_id": i, "rot_correction": 0.0, "vert_correction": 0.01 * i} for i in range(16)]
    return str(yaml.safe_dump({"lasers": lasers, "num_lasers": 16}))


HARNESSES: dict[str, Harness] = {
    "result": Harness(_result, _result_seeds),
    "pointcloud2": Harness(
        _messages(CLOUD, lambda m: decode_pointcloud2(m, limits=LIMITS)), lambda: _message_seeds(CLOUD, *_clouds())()
    ),
    "image": Harness(
        _messages(IMAGE, lambda m: decode_any_image(m, limits=LIMITS)), lambda: _message_seeds(IMAGE, *_images())()
    ),
    "compressed_image": Harness(
        _messages(COMPRESSED, lambda m: decode_any_image(m, limits=LIMITS)),
        lambda: _message_seeds(COMPRESSED, *_compressed())(),
    ),
    "camera_info": Harness(
        _messages(INFO, _decode_info),
        _message_seeds(INFO, camera_info(np.diag([5.0, 5.0, 1.0]), stamp_ns=T0, width_px=4, height_px=4)),
    ),
    "tf": Harness(
        _messages(TF, _decode_tf),
        _message_seeds(
            TF,
            tf_message([transform_stamped(*edge, stamp_ns=T0) for edge in (("a", "b"), ("b", "c"))]),
            tf_message([transform_stamped(*edge, stamp_ns=T0) for edge in (("a", "b"), ("b", "c"), ("c", "a"))]),
        ),
    ),
    "odometry": Harness(_messages(ODOMETRY, decode_odometry), _message_seeds(ODOMETRY, odometry(stamp_ns=T0))),
    "to_ros2": Harness(_messages(ODOMETRY, to_ros2), _message_seeds(ODOMETRY, odometry(stamp_ns=T0))),
    "detections2d": Harness(
        _messages(BOXES, lambda m: decode_detections2d(m, {"car": 0}, class_names=["car"])),
        _message_seeds(
            BOXES, detection2d_array([[0, 0, 5, 5]] * 2, class_names=["car", "0"], scores=[0.5, 0.6], stamp_ns=T0)
        ),
    ),
    "detections3d": Harness(_objects, _object_seeds),
    "detected_objects": Harness(_detected_objects, _detected_seeds),
    "diagnostics": Harness(
        _messages(STATUS, lambda m: decode_diagnostics(m, limits=LIMITS)),
        _message_seeds(STATUS, {"status": [{"name": "a", "values": [{"key": "skew_ms", "value": "1.5"}]}]}),
    ),
    "velodyne_scan": Harness(
        _messages(SCAN, lambda m: VelodyneDecoders(Config().velodyne)[m.topic](m)),
        lambda: _message_seeds(SCAN, *_scans())(),
    ),
    "combined": Harness(
        _combined, lambda: [bytes([i]) + bytes(_combined_message(e).data) for i, e in enumerate(ENCODINGS)]
    ),
    "scene": Harness(_whole_scene, lambda: [b"", bytes(range(64))]),
    "foxglove_protobuf": Harness(_foxglove("protobuf"), _foxglove_seeds("protobuf")),
    "foxglove_json": Harness(
        _foxglove("json"),
        lambda: [*_foxglove_seeds("json")(), b"\1" + b"[" * 2000, b"\1" + json.dumps({"data": [[]] * 50}).encode()],
    ),
    "video": Harness(_video, _video_seeds),
    "protobuf_schema": Harness(_protobuf_schema, _protobuf_schema_seeds),
    "definition": Harness(_definition, _definition_seeds),
    "rig": Harness(_text("rig.yaml", _use_rig), _texts(RIG, GEOMETRY, KITTI, CALIB_TXT, CAMCHAIN, SENSOR_KIT, TO_DO)),
    "kitti_labels": Harness(_text("label_2/0.txt", _use_kitti_labels), _texts(KITTI_LABELS, f"0 1 {KITTI_LABELS}")),
    "openlabel": Harness(
        _text("a.json", lambda path: OpenLabelTruth(path, LABELLED, Config()).at(T0, frame=0)), _texts(OPENLABEL)
    ),
    "predecessor_odometry": Harness(
        _text("odom/30000.txt", lambda path: PredecessorTruth(path.parents[1], LABELLED, Config()).at(T0, frame=0)),
        _texts("1 2 3 0 0 0 1\n", "1 2 3 4 5 6 7\n", "1 2 3\n4 5 6\n"),
    ),
    "predecessor_cloud": Harness(_text("pcd/0.txt", _use_evaluation_folder), _texts("1 2 3 4\n5 6 7 8\n", "1,2,3,4\n")),
    "config": Harness(_text("config.yaml", load_config), lambda: _texts(dump_config(Config())[:600])()),
    "metadata": Harness(_text("folder/metadata.yaml", _use_folder), _texts(METADATA)),
    "velodyne_calibration": Harness(
        _text("lasers.yaml", lambda path: read_velodyne_calibration(path, MODELS["VLP-16"])),
        lambda: _texts(_calibration())(),
    ),
}
"""By name."""
