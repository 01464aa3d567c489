"""What is fuzzed: for every decoder a function of bytes, and inputs to begin with.

The contract of each: whatever the bytes, nothing but a `LidcamError` leaves lidcam's readers, its text is one short
line, and memory and time stay bounded. A new decoder gets a line in `HARNESSES`; texts to begin with, and what was
found, are files in `corpus/NAME/`.
"""

import json
import struct
from base64 import b64decode, b64encode
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import yaml
from builders import Fields, image, odometry, pointcloud2, raw, tf_message, transform_stamped
from combined_messages import CAMERAS, combined
from foxglove_messages import SCHEMA_OF, foxglove_raw, twin
from frames import frame, written_result
from memory_recording import MemoryRecording
from message_harnesses import CONFIG, ENCODINGS, LIMITS, MESSAGES, T0, Encoding, Harness, hold, images, info

from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import dump_config, load_config
from lidcam.readers.files.rosbag2_folder import recording_files
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.recording import ReadOptions, Recording
from lidcam.readers.results.result import open_result
from lidcam.readers.rig.discovery import discover_rig
from lidcam.readers.rig.rig_file import load_rig
from lidcam.readers.streams.motion import find_motion_source
from lidcam.readers.streams.per_sensor import sensor_messages
from lidcam.readers.streams.survey import survey
from lidcam.readers.truth.kitti import KittiTruth
from lidcam.readers.truth.open import open_truth
from lidcam.readers.velodyne.decoder import read_velodyne_calibration
from lidcam.readers.velodyne.models import MODELS

CORPUS = Path(__file__).parent / "corpus"
MAX_MESSAGES = 3000


def inputs(name: str) -> list[bytes]:
    """What is known of a decoder: its seeds and its files."""
    return [*HARNESSES[name].seeds(), *(path.read_bytes() for path in sorted((CORPUS / name).glob("*")))]


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
            found = discover_rig(opened, CONFIG)
            find_motion_source(opened, found.rig, found.transforms, CONFIG)


def _scene() -> list[RawMessage]:
    """One message of every kind."""
    points = np.arange(12, dtype=np.float32).reshape(-1, 3)
    fields: dict[str, tuple[str, Fields]] = {
        "/points": ("sensor_msgs/msg/PointCloud2", pointcloud2(points, stamp_ns=T0, intensity=points[:, 0])),
        "/camera/image_raw": ("sensor_msgs/msg/Image", image(np.zeros((4, 4, 3), np.uint8), stamp_ns=T0)),
        "/camera/camera_info": ("sensor_msgs/msg/CameraInfo", info()),
        "/tf_static": ("tf2_msgs/msg/TFMessage", tf_message([transform_stamped("lidar", "camera", stamp_ns=T0)])),
        "/odom": ("nav_msgs/msg/Odometry", odometry(stamp_ns=T0)),
    }
    return [raw(topic, msgtype, message, T0 + i) for i, (topic, (msgtype, message)) in enumerate(fields.items())]


def _result(data: bytes) -> None:
    hold(_read_result, _file("out.mcap", data))


def _read_result(path: Path) -> None:
    with open_result(path, options=ReadOptions(limits=LIMITS)) as result, open_truth(result) as truth:
        frames = EvaluationFrames(result, truth)
        for _ in islice(frames, MAX_MESSAGES):
            pass
        if any("\n" in note for note in frames.notes):
            raise AssertionError(f"notes of one line each were expected, found {frames.notes}")


def _result_seeds() -> list[bytes]:
    frames = [frame(index, motion=True) for index in range(2)]
    config = load_config(settings=["output.clouds=false", "output.images=false", "output.compression=none"])
    with TemporaryDirectory() as folder:
        paths = [written_result(Path(folder, f"{n}.mcap"), frames[:n], config=config) for n in (0, 2)]
        return [path.read_bytes() for path in paths]


def _combined(data: bytes) -> None:
    """A combined message, taken apart."""
    for encoding in ENCODINGS[data[0] & 1 : (data[0] & 1) + 1] if data else ():
        whole = _combined_message(encoding)._replace(data=data[1:])
        hold(_read_everything, MemoryRecording([whole, _combined_message(encoding)]))


@cache
def _combined_message(encoding: Encoding) -> RawMessage:
    parts = [raw("/a", "sensor_msgs/msg/Image", one, T0, encoding=encoding) for one in images()[:2]]
    return combined("/all", CAMERAS, parts, T0, encoding)


def _whole_scene(data: bytes) -> None:
    """A recording whose messages are altered: the calibration is looked for in it."""
    messages = _scene()
    for begin in range(0, len(data) - 3, 4):
        number, place, value = struct.unpack_from("<BHB", data, begin)
        message = messages[number % len(messages)]
        altered = bytearray(message.data)
        altered[place % len(altered)] = value
        messages[number % len(messages)] = message._replace(data=bytes(altered))
    hold(_read_everything, MemoryRecording(messages))


def _foxglove(encoding: Literal["protobuf", "json"], *hostile: bytes) -> Harness:
    """Messages with one of Foxglove's schemas; the first byte says which."""
    schemas = sorted({*SCHEMA_OF.values(), "foxglove.FrameTransform"})

    def run(data: bytes) -> None:
        schema = schemas[data[0] % len(schemas) if data else 0]
        message = foxglove_raw("/topic", schema, {}, T0, encoding)._replace(data=data[1:])
        hold(_read_everything, MemoryRecording([message]))

    def seeds() -> list[bytes]:
        twins = [twin(message, encoding) for message in _scene() if message.channel.msgtype in SCHEMA_OF]
        known = [bytes([schemas.index(message.channel.msgtype)]) + bytes(message.data) for message in twins]
        return [*known, *hostile]

    return Harness(run, seeds)


def _protobuf_schema(data: bytes) -> None:
    """The description of a protobuf type, then one message of that type."""
    source = foxglove_raw("/topic", "foxglove.PointCloud", {}, T0)
    altered = Channel("/topic", source.channel.msgtype, "protobuf", b64encode(data).decode(), "protobuf")
    message = twin(_scene()[0], "protobuf")._replace(channel=altered)
    hold(_read_everything, MemoryRecording([message]))


def _protobuf_schema_seeds() -> list[bytes]:
    return [b64decode(foxglove_raw("/topic", "foxglove.PointCloud", {}, T0).channel.definition)]


def _of_text(name: str, read: Callable[[Path], Any], sound: Callable[[], str] = str) -> Harness:
    """A reader of text files."""
    return Harness(
        lambda data: hold(read, _file(name, data)), lambda: [text.encode() for text in (sound(), *HOSTILE_YAML)]
    )


def _use_rig(path: Path) -> None:
    discover_rig(MemoryRecording(_scene()), CONFIG, load_rig(path))


def _use_folder(path: Path) -> None:
    folder = path.parent
    (folder / "a_0.db3").touch()
    for file in recording_files(folder):
        if file.resolve().parent != folder.resolve():
            raise AssertionError(f"{file} is not in the folder")


def _use_kitti_labels(path: Path) -> None:
    calibration = path.parents[1] / "calib" / path.name
    calibration.parent.mkdir(exist_ok=True)
    calibration.write_bytes((CORPUS / "rig" / "kitti_calib.txt").read_bytes())
    truth = KittiTruth(path, LABELLED, Config())
    truth.at(T0, frame=0)
    truth.in_image("camera", T0, frame=0)


LABELLED = Rig("lidar", (LidarSensor("lidar", "/points", Transform.identity("lidar", "lidar")),), (), ())
ALIASES = "a: &a [1, 1, 1]\n" + "\n".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join([f'*{chr(97 + i)}'] * 9)}]" for i in range(12)
)
MERGES = "a: &a {x: 1, y: 2}\n" + "\n".join(
    f"{chr(98 + i)}: &{chr(98 + i)}\n  <<: [{', '.join([f'*{chr(97 + i)}'] * 9)}]" for i in range(9)
)
VALUES = "a: &a [*a]", "[" * 3000, "a: 2001-99-99", f"a: {'9' * 5000}", "a: 1e99999", "? [a]\n: b"
HOSTILE_YAML = [ALIASES, MERGES, *VALUES]


def _calibration() -> str:
    lasers = [{"laser_id": i, "rot_correction": 0.0, "vert_correction": 0.01 * i} for i in range(16)]
    return str(yaml.safe_dump({"lasers": lasers, "num_lasers": 16}))


HARNESSES: dict[str, Harness] = MESSAGES | {
    "result": Harness(_result, _result_seeds),
    "combined": Harness(
        _combined, lambda: [bytes([i]) + bytes(_combined_message(e).data) for i, e in enumerate(ENCODINGS)]
    ),
    "scene": Harness(_whole_scene, lambda: [b"", bytes(range(64))]),
    "foxglove_protobuf": _foxglove("protobuf"),
    "foxglove_json": _foxglove("json", b"\1" + b"[" * 2000, b"\1" + json.dumps({"data": [[]] * 50}).encode()),
    "protobuf_schema": Harness(_protobuf_schema, _protobuf_schema_seeds),
    "rig": _of_text("rig.yaml", _use_rig),
    "kitti_labels": _of_text("label_2/0.txt", _use_kitti_labels),
    "config": _of_text("config.yaml", load_config, lambda: dump_config(Config())[:600]),
    "metadata": _of_text("folder/metadata.yaml", _use_folder),
    "velodyne_calibration": _of_text(
        "lasers.yaml", lambda path: read_velodyne_calibration(path, MODELS["VLP-16"]), _calibration
    ),
}
"""By name."""
