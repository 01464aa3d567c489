"""Changed message definitions: `python tests/campaign/definitions.py [--minutes M | --count N] [--seed S]`.

In a small recording with every type of message that lidcam reads, the definition of one topic is changed (fields
dropped, renamed, retyped, moved, arrays of other lengths, nested definitions exchanged, text cut or overwritten;
protobuf descriptors and JSON values likewise), and in some cases the bytes of its messages, too. Then everything that
reads is run: the topics, the survey, the rig, the motion, and the decoder of each message. Nothing but a `LidcamError`
may leave it, and a message whose definition still says the same must not silently get other values.
"""

import json
import logging
import re
import resource
import sys
import tempfile
import warnings
from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, Literal

from common import Outcome, campaign, is_one_line  # isort: skip
import numpy as np
from builders import raw, write_mcap
from combined_messages import CAMERAS, combined
from foxglove_messages import SCHEMA_OF, twin
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from harnesses import _compressed, _images, _scans
from memory_recording import MemoryRecording
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from small_drive import START_NS, small_drive

from lidcam import api
from pipeline.core.errors import LidcamError
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.ros.typestores import extra_types
from pipeline.core.settings.config import Config
from readers.messages.camera_info import camera_model, rectified_camera_model
from readers.messages.deserialize import definition_problem, deserialize
from readers.messages.image import decode_any_image
from readers.messages.odometry import decode_odometry
from readers.messages.pointcloud2 import decode_pointcloud2
from readers.messages.tf import decode_transforms
from readers.messages.vision.detections2d import decode_detections2d
from readers.rig.discovery import discover_rig
from readers.streams.motion import MotionBuffer, find_motion_source
from readers.streams.per_sensor import sensor_messages
from readers.streams.survey import survey
from readers.velodyne.decoder import VelodyneDecoders

__all__ = ["TEST_COUNT", "main"]

TEST_COUNT = 15
MAX_MEMORY = 6 << 30
WHOLE_RUN_SHARE = 0.04
"""Cases that are also inspected and processed as a file."""

BYTES: tuple[Literal["as they were", "damaged", "of the new definition"], ...] = (
    "as they were",
    "damaged",
    "of the new definition",
    "of the new definition",
)
Encoding = Literal["ros1", "cdr", "protobuf", "json"]
KINDS = (
    "string",
    "wstring",
    "bool",
    "int8",
    "uint8",
    "char",
    "byte",
    "int64",
    "uint64",
    "float32",
    "float64",
    "time",
    "duration",
    "Header",
    "std_msgs/Header",
    "builtin_interfaces/Time",
    "geometry_msgs/Point",
    "geometry_msgs/Pose",
    "sensor_msgs/Image",
    "no_such_msgs/Type",
)
BOUNDS = ("", "[]", "[1]", "[3]", "[9]", "[<=4]", "[0]", "[99999999999]", "[-1]", "[")
NAMES = ("x", "class", "def", "None", "self", "header", "data", "1", "a b", "stamp", "__init__", "K", "return", "é")
SEPARATOR = "=" * 80


def main(arguments: Sequence[str] | None = None) -> int:
    """1 if anything but a told error left the readers, or a message changed in silence."""
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("error")
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, limits[1]))
    try:
        return campaign("definitions", _try_case, count=2000, arguments=arguments, max_case_s=20)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
        warnings.resetwarnings()
        logging.disable(logging.NOTSET)


def _try_case(_: int, chance: Random) -> Outcome:
    encoding: Encoding = chance.choice(("ros1", "cdr", "cdr", "protobuf", "json"))
    messages = [*_messages(encoding)]
    source = chance.choice(sorted({message.channel for message in messages}, key=lambda one: one.topic))
    changed, told = _changed_channel(source, chance)
    bytes_are: Literal["as they were", "damaged", "of the new definition"] = chance.choice(BYTES)
    for row, message in enumerate(messages):
        if message.channel == source:
            data = bytes(message.data)
            if bytes_are == "damaged" or encoding == "json":
                data = _damaged(message, chance)
            elif bytes_are == "of the new definition":
                data = _refilled(changed, chance) or data
            messages[row] = message._replace(channel=changed, data=data)
    damages = encoding == "json" or bytes_are != "as they were"
    what = f"{encoding} {source.topic} {source.msgtype}, bytes {bytes_are}: {told}"
    files = {"definition.txt": changed.definition.encode(errors="replace")}
    found = _read(messages, chance)
    if chance.random() < WHOLE_RUN_SHARE:
        _process(messages)
    unforeseen = {text for text in found.values() if isinstance(text, str) and text.startswith("!")}
    if bad := next((text for text in found.values() if isinstance(text, str) and not is_one_line(text)), ""):
        return Outcome("not one line", is_fault=True, detail=f"{what}: {bad}", files=files)
    clean = _clean(encoding)
    of_topic = [key for key in clean if key[0] == source.topic or key[0].startswith(f"{source.topic}/")]
    if others := [key for key in clean if key not in of_topic and found.get(key) != clean[key]]:
        return Outcome("another topic changed", is_fault=True, detail=f"{what}: {others[0]}", files=files)
    if unforeseen:
        return Outcome("told, by its cause", detail=f"{what}: {min(unforeseen)}", files=files)
    if any(isinstance(found.get(key, "missing"), str) for key in of_topic):
        return Outcome("told", detail=what)
    if all(found[key] == clean[key] for key in of_topic):
        return Outcome("decoded equal", detail=what)
    if damages or _says_otherwise(source, changed):
        return Outcome("decoded as the definition says", detail=what)
    return Outcome("silently other values", is_fault=True, detail=what, files=files)


# --- what is read


@cache
def _messages(encoding: Encoding) -> tuple[RawMessage, ...]:
    """Two or so of every kind."""
    ros: Literal["ros1", "cdr"] = "ros1" if encoding == "ros1" else "cdr"
    messages = small_drive(ros, frames=2, motion="odometry", kinds=("images", "boxes"))
    messages += [m for m in small_drive(ros, frames=2, motion="tf") if m.topic == "/tf"]
    if encoding in {"protobuf", "json"}:
        return tuple(twin(m, encoding) for m in messages if m.channel.msgtype in SCHEMA_OF)
    at_ns = START_NS + 50_000_000
    compressed = _compressed()[0]
    messages.append(raw("/jpeg/image/compressed", "sensor_msgs/msg/CompressedImage", compressed, at_ns, at_ns, ros))
    scan = next(iter(_scans()))
    for one in scan["packets"]:
        one["data"][1200:1204] = 0  # the sensor's own time
    messages.append(raw("/velodyne_packets", "velodyne_msgs/msg/VelodyneScan", scan, at_ns, at_ns, ros))
    packet = "velodyne_msgs/msg/VelodynePacket"
    messages += [raw("/packets", packet, one, at_ns + i, at_ns + i, ros) for i, one in enumerate(scan["packets"])]
    images = [raw("/a", "sensor_msgs/msg/Image", one, at_ns, encoding=ros) for one in _images()[:2]]
    messages.append(combined("/all", CAMERAS, images, at_ns, ros))
    return tuple(messages)


@cache
def _clean(encoding: Encoding) -> dict[tuple[str, int], object]:
    return _read([*_messages(encoding)], Random(0))


def _read(messages: Sequence[RawMessage], chance: Random) -> dict[tuple[str, int], object]:
    """By topic and place in it, what each message was decoded to, or what was said instead."""
    del chance
    config = Config()
    velodyne = VelodyneDecoders(config.velodyne)
    found: dict[tuple[str, int], object] = {}
    with sensor_messages(MemoryRecording(messages)) as recording:
        survey(recording)
        with suppress(LidcamError):
            rig = discover_rig(recording, config)
            source = find_motion_source(recording, rig.rig, rig.transforms, config)
            for _ in MotionBuffer(source).tap(recording.messages()):
                pass
        for info in recording.topics:
            for one in info.channels:
                definition_problem(one)
        counts: dict[str, int] = {}
        for message in recording.messages():
            place = counts[message.topic] = counts.get(message.topic, -1) + 1
            try:
                value = _plain(_decode(message, velodyne))
            except LidcamError as err:
                cause = err.__cause__
                unforeseen = cause is not None and not isinstance(cause, LidcamError) and "cannot be used" in str(err)
                found[message.topic, place] = f"{'!' if unforeseen else ''}{err}"
            else:
                found[message.topic, place] = (value, message.stamp_ns)
    return found


def _decode(message: RawMessage, velodyne: VelodyneDecoders) -> Any:
    match message.channel.msgtype:
        case "sensor_msgs/msg/PointCloud2":
            return decode_pointcloud2(message)
        case "sensor_msgs/msg/Image" | "sensor_msgs/msg/CompressedImage":
            return decode_any_image(message)
        case "sensor_msgs/msg/CameraInfo":
            info = deserialize(message)
            with suppress(LidcamError):
                rectified_camera_model(info)
            return camera_model(info)
        case "tf2_msgs/msg/TFMessage":
            return [(stamp, child) for stamp, _, child in decode_transforms(message)]
        case "nav_msgs/msg/Odometry":
            return decode_odometry(message)
        case "vision_msgs/msg/Detection2DArray":
            return decode_detections2d(message, {"car": 0})
        case "velodyne_msgs/msg/VelodyneScan":
            return velodyne[message.topic].decode(message)
        case _:
            return deserialize(message)


def _plain(value: Any) -> object:
    """The content of records, comparable."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if is_dataclass(value):
        return tuple(_plain(getattr(value, one.name)) for one in fields(value))
    if isinstance(value, Mapping):
        return tuple((key, _plain(item)) for key, item in value.items())
    if isinstance(value, list | tuple):
        return tuple(map(_plain, value))
    return repr(value)


def _process(messages: Sequence[RawMessage]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        write_mcap(path, messages)
        with suppress(LidcamError):
            api.inspect(path)
        with suppress(LidcamError):
            api.process(path, Path(folder) / "out.mcap", workers=1)


# --- changes


def _changed_channel(source: Channel, chance: Random) -> tuple[Channel, str]:
    match source.encoding:
        case "json":
            return source, "JSON"
        case "protobuf":
            definition, told = _changed_descriptor(b64decode(source.definition), source.msgtype, chance)
            return replace(source, definition=b64encode(definition).decode()), told
    text = source.definition
    changes: list[str] = []
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        text, done = chance.choice(TEXT_CHANGES)(text, chance)
        changes.append(done)
    return replace(source, definition=text), "; ".join(changes)


def _lines(text: str) -> list[str]:
    return text.split("\n")


def _field_row(lines: Sequence[str], chance: Random) -> int:
    rows = [row for row, line in enumerate(lines) if re.match(r"\s*[\w/]+(\[.*\])?\s+\w+\s*$", line)]
    return chance.choice(rows) if rows else chance.randrange(len(lines))


def _drop(text: str, chance: Random) -> tuple[str, str]:
    lines = _lines(text)
    row = _field_row(lines, chance)
    line = lines.pop(row)
    return "\n".join(lines), f"without {line!r}"


def _double(text: str, chance: Random) -> tuple[str, str]:
    lines = _lines(text)
    row = _field_row(lines, chance)
    lines.insert(chance.randrange(len(lines)), lines[row])
    return "\n".join(lines), f"{lines[row]!r} twice"


def _swap(text: str, chance: Random) -> tuple[str, str]:
    lines = _lines(text)
    first, second = _field_row(lines, chance), _field_row(lines, chance)
    lines[first], lines[second] = lines[second], lines[first]
    return "\n".join(lines), f"{lines[first]!r} and {lines[second]!r} exchanged"


def _rename(text: str, chance: Random) -> tuple[str, str]:
    lines = _lines(text)
    row = _field_row(lines, chance)
    kind = lines[row].split(" ")[0]
    name = chance.choice(NAMES)
    lines[row] = f"{kind} {name}"
    return "\n".join(lines), f"a field called {name}"


def _retype(text: str, chance: Random) -> tuple[str, str]:
    lines = _lines(text)
    row = _field_row(lines, chance)
    before = lines[row]
    lines[row] = f"{chance.choice(KINDS)}{chance.choice(('', '', *BOUNDS))} {before.split(' ')[-1]}"
    return "\n".join(lines), f"{before!r} as {lines[row]!r}"


def _rebound(text: str, chance: Random) -> tuple[str, str]:
    lines = _lines(text)
    row = _field_row(lines, chance)
    before = lines[row]
    kind, _, name = before.partition(" ")
    lines[row] = f"{kind.split('[')[0]}{chance.choice(BOUNDS)} {name}"
    return "\n".join(lines), f"{before!r} as {lines[row]!r}"


def _constant(text: str, chance: Random) -> tuple[str, str]:
    lines = _lines(text)
    added = chance.choice(("int32 N=5", "string S=a # b", "uint8 N=999", "float64 header=1", "int8 N=x", "bool B = 2"))
    lines.insert(chance.randrange(len(lines)), added)
    return "\n".join(lines), f"{added!r} added"


def _nested(text: str, chance: Random) -> tuple[str, str]:
    """One of the nested definitions dropped, renamed, doubled, or made recursive."""
    parts = text.split(f"{SEPARATOR}\n")
    if len(parts) == 1:
        return _drop(text, chance)
    row = chance.randrange(1, len(parts))
    name = parts[row].split("\n")[0].removeprefix("MSG: ")
    match chance.randrange(4):
        case 0:
            del parts[row]
            told = f"without {name}"
        case 1:
            other = chance.randrange(len(parts))
            head, _, body = parts[other].partition("\n")
            parts[row] = f"MSG: {name}\n{body if other else head}"
            told = f"{name} is another"
        case 2:
            parts[row] += f"{name} again\n"
            told = f"{name} holds itself"
        case _:
            parts[row] = parts[row].replace(name, f"{name}X", 1)
            told = f"{name} called {name}X"
    return f"{SEPARATOR}\n".join(parts), told


def _cut(text: str, chance: Random) -> tuple[str, str]:
    at = chance.randrange(len(text) + 1)
    return text[:at], f"cut at {at}"


def _noise(text: str, chance: Random) -> tuple[str, str]:
    letters = [*text]
    for _ in range(chance.randint(1, 6)):
        letters[chance.randrange(len(letters))] = chr(chance.choice((chance.randrange(256), chance.randrange(32, 127))))
    return "".join(letters), "noise"


def _comment(text: str, chance: Random) -> tuple[str, str]:
    lines = _lines(text)
    row = _field_row(lines, chance)
    lines[row] += "  # a comment"
    lines.insert(row, "")
    return "\n".join(lines), "a comment"


TEXT_CHANGES: tuple[Callable[[str, Random], tuple[str, str]], ...] = (
    _drop,
    _double,
    _swap,
    _rename,
    _retype,
    _retype,
    _rebound,
    _constant,
    _nested,
    _cut,
    _noise,
    _comment,
)


def _changed_descriptor(data: bytes, msgtype: str, chance: Random) -> tuple[bytes, str]:
    if chance.random() < 0.3:
        noisy = bytearray(data)
        for _ in range(chance.randint(1, 4)):
            noisy[chance.randrange(len(noisy))] = chance.randrange(256)
        return bytes(noisy), "noise"
    files = FileDescriptorSet.FromString(data)
    types = [message for file in files.file for message in file.message_type]
    named = next(message for message in types if msgtype.endswith(f".{message.name}"))
    message = named if chance.random() < 0.6 else chance.choice(types)
    if not message.field:
        return data, "nothing"
    row = chance.randrange(len(message.field))
    changed = message.field[row]
    name = f"{message.name}.{changed.name}"
    match chance.randrange(6):
        case 0:
            del message.field[row]
            told = f"without {name}"
        case 1:
            changed.name = chance.choice(NAMES)
            told = f"{name} called {changed.name}"
        case 2:
            changed.type = chance.randint(1, 18)
            changed.type_name = ""
            told = f"{name} of type {changed.type}"
        case 3:
            changed.label = chance.choice((1, 2, 3))
            told = f"{name} with label {changed.label}"
        case 4:
            changed.number = chance.choice((1, 2, 3, 15, 19000, 2**29 - 1, message.field[0].number))
            told = f"{name} with number {changed.number}"
        case _:
            changed.type, changed.type_name = 11, chance.choice((".foxglove.Pose", ".foxglove.No", f".{msgtype}"))
            told = f"{name} of type {changed.type_name}"
    return files.SerializeToString(), told


def _damaged(message: RawMessage, chance: Random) -> bytes:
    data = bytearray(message.data)
    if message.channel.encoding == "json":
        return _changed_json(bytes(data), chance)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(min(len(data), 200)) if data else 0
        match chance.randrange(4):
            case 0:
                data[at : at + 1] = bytes([chance.randrange(256)])
            case 1:
                data[at : at + 4] = chance.choice((0, 1, 2**16, 2**31 - 1, 2**32 - 1)).to_bytes(4, "little")
            case 2:
                del data[at : at + chance.randrange(8)]
            case _:
                data[at:at] = chance.randbytes(chance.randrange(8))
    return bytes(data)


WRONG: tuple[Any, ...] = (None, True, -1, 0, 1e300, 2**70, "", "x", [], [1], {}, {"x": 1}, [[]], {"sec": -1}, "bm8=")


def _refilled(channel: Channel, chance: Random) -> bytes:
    """A message of any values that fits its definition; empty if the definition is of no use."""
    if channel.encoding not in {"ros1", "cdr"}:
        return b""
    try:
        store = get_typestore(Stores.ROS1_NOETIC if channel.encoding == "ros1" else Stores.ROS2_HUMBLE)
        types = get_types_from_msg(channel.definition, channel.msgtype)
        if any(
            node == Nodetype.ARRAY and int(detail[1]) > 1000 for _, kept in types.values() for _, (node, detail) in kept
        ):
            return b""  # rosbags writes code for each element
        store.register({**extra_types(1 if channel.encoding == "ros1" else 2), **types})
        message = _filled(store, channel.msgtype, chance, 0)
        serialized = store.serialize_ros1 if channel.encoding == "ros1" else store.serialize_cdr
        return bytes(serialized(message, channel.msgtype))
    except Exception:  # whatever rosbags makes of it
        return b""


def _filled(store: Any, msgtype: str, chance: Random, depth: int) -> Any:
    if depth > 6:
        raise ValueError("recursive")
    return store.types[msgtype](
        *(_value(store, node, detail, chance, depth) for _, (node, detail) in store.fielddefs[msgtype][1])
    )


def _value(store: Any, node: Any, detail: Any, chance: Random, depth: int) -> Any:
    if node == Nodetype.NAME:
        return _filled(store, detail, chance, depth + 1)
    if node == Nodetype.BASE:
        return _scalar(detail[0], chance)
    (item_node, item_detail), length = detail
    count = length if node == Nodetype.ARRAY else chance.choice((0, 1, 2, 3, 9))
    items = [_value(store, item_node, item_detail, chance, depth) for _ in range(min(count, 5000))]
    if item_node == Nodetype.BASE and item_detail[0] not in {"string", "wstring"}:
        dtype = {"byte": "u1", "char": "u1", "octet": "u1"}.get(item_detail[0], item_detail[0])
        return np.array(items, dtype)
    return items


def _scalar(base: str, chance: Random) -> Any:
    if base in {"string", "wstring"}:
        return chance.choice(("", "lidar", "base_link", "odom", "rgb8", "jpeg", "plumb_bob", "x", "car", "\0", "\n"))
    if base == "bool":
        return chance.random() < 0.5
    if base.startswith("float"):
        return chance.choice((0.0, 1.0, -1.0, 1e300 if base == "float64" else 1e38, float("nan"), float("inf"), 0.5))
    bits = {"byte": 8, "char": 8, "octet": 8}.get(base) or int(re.sub(r"\D", "", base))
    high = 2 ** (bits if not base.startswith("int") else bits - 1) - 1
    low = -high - 1 if base.startswith("int") else 0
    return chance.choice((0, 0, 1, 1, 2, 7, 8, 12, low, high, chance.randint(low, high)))


def _changed_json(data: bytes, chance: Random) -> bytes:
    tree = json.loads(data)
    where: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            where.append((node, key))
            walk(node[key])

    walk(tree)
    node, key = chance.choice(where)
    if chance.random() < 0.2:
        del node[key]
    else:
        node[key] = chance.choice(WRONG)
    text = json.dumps(tree)
    return (text if chance.random() < 0.8 else text[: chance.randrange(len(text))]).encode()


def _says_otherwise(before: Channel, after: Channel) -> bool:
    """Whether a changed definition says anything else, as rosbags reads both; a descriptor that changed does."""
    if before.encoding not in {"ros1", "cdr"}:
        return before != after
    try:
        types = [get_types_from_msg(one.definition, one.msgtype) for one in (before, after)]
    except Exception:
        return True
    return {name: kept[1] for name, kept in types[0].items()} != {name: kept[1] for name, kept in types[1].items()}


if __name__ == "__main__":
    sys.exit(main())
