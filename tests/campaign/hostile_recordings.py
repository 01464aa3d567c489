"""Small recordings that ask for a lot of memory, disk or time: one function for each way, in `HOSTILE`.

Each writes a recording of at most a few hundred kilobytes into a folder and returns what to read of it. Their sizes are
up to `Random`, around the limits of the settings: some are refused, some are just within. What a single reader can show
is in `tests/readers/files/test_hostile_files.py`.
"""

import io
import sqlite3
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

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
    raw,
    serialize,
    tf_message,
    time,
    transform_stamped,
    write_mcap,
)
from video import encode

from lidcam.pipeline.core.messages import RawMessage

Hostile = Callable[[Random, Path], list[Path]]
Messages = Iterator[RawMessage]

MIB = 1 << 20
PERIOD_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000
CLOUD, IMAGE, COMPRESSED = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
TF, BOXES, ODOMETRY = "tf2_msgs/msg/TFMessage", "vision_msgs/msg/Detection2DArray", "nav_msgs/msg/Odometry"
VIDEO = "foxglove_msgs/msg/CompressedVideo"
HEAD_BYTES = 20
"""Of a CDR message: its encoding, a stamp, and a frame of up to three letters with its length."""


def _at(number: int) -> int:
    return START_NS + number * PERIOD_NS


POINTS = ((5, 1, 0), (6, 1, 0), (7, 2, 1))


def _cloud(topic: str, number: int, points: Any = POINTS, frame_id: str = "lidar") -> RawMessage:
    return raw(topic, CLOUD, pointcloud2(points, stamp_ns=_at(number), frame_id=frame_id), _at(number))


def _again(data: bytes, topic: str, msgtype: str, number: int, frame_id: str) -> RawMessage:
    """A large message with another stamp and frame: to serialise each of them takes too long."""
    head = serialize("std_msgs/msg/Header", header(_at(number), frame_id)).ljust(HEAD_BYTES, b"\0")
    return RawMessage(_at(number), _at(number), (0, 0), head + data[HEAD_BYTES:], channel(topic, msgtype))


def _statics(frames: Iterable[str]) -> RawMessage:
    turn = (-0.5, 0.5, -0.5, 0.5)
    links = [transform_stamped("base_link", name, stamp_ns=START_NS, rotation_xyzw=turn) for name in frames]
    return raw("/tf_static", TF, tf_message(links), START_NS)


def _cameras(count: int, frames: int, topic: str, msgtype: str, side_px: int, *messages: bytes) -> Messages:
    """A lidar beside cameras that take the same messages again and again."""
    yield _statics(["lidar", *(f"c{number}" for number in range(count))])
    k = np.array([[500, 0, side_px / 2], [0, 500, side_px / 2], [0, 0, 1]])
    for camera in range(count):
        info = camera_info(k, stamp_ns=START_NS, width_px=side_px, height_px=side_px, frame_id=f"c{camera}")
        yield raw(f"/c{camera}/camera_info", "sensor_msgs/msg/CameraInfo", info, START_NS)
    for number in range(frames):
        yield _cloud("/points", number)
        for camera in range(count):
            yield _again(messages[number % len(messages)], f"/c{camera}/{topic}", msgtype, number, f"c{camera}")


def _clouds(count: int = 3) -> Messages:
    """A lidar beside what is hostile."""
    return (_cloud("/points", number) for number in range(count))


def _many_points(chance: Random, count: int) -> np.ndarray[Any, Any]:
    """Points that compress well and lie apart from one another: a pattern, again and again."""
    kind = chance.choice(["zeros", "one", "pattern"])
    if kind != "pattern":
        return np.full((count, 3), 0 if kind == "zeros" else 3, np.float32)
    pattern = np.random.default_rng(chance.randrange(1000)).uniform(-50, 50, (3000, 3)).astype(np.float32)
    return np.resize(pattern, (count, 3))


# --- messages


def clouds_of_many_points(chance: Random) -> Messages:
    """Several lidars with up to ten million points in each sweep."""
    lidars, count = chance.choice([1, 4, 12]), chance.choice([1_000_000, 3_000_000, 9_999_999])
    data = bytes(_cloud("/l0/points", 0, _many_points(chance, count), "l0").data)
    yield _statics([f"l{lidar}" for lidar in range(lidars)])
    for number in range(3):
        for lidar in range(lidars):
            yield _again(data, f"/l{lidar}/points", CLOUD, number, f"l{lidar}")


def raw_images(chance: Random) -> Messages:
    """Raw images of up to a hundred million pixels of several cameras, plain."""
    cameras, side = chance.choice([1, 8]), chance.choice([4000, 9900])
    fields = image(np.zeros((side, side), np.uint8), stamp_ns=START_NS, frame_id="c0", encoding="mono8")
    return _cameras(cameras, 3, "image", IMAGE, side, serialize(IMAGE, fields))


def compressed_images(chance: Random) -> Messages:
    """JPEG, PNG, WebP and TIFF of nearly a hundred million pixels."""
    kind, side = chance.choice([".jpg", ".png", ".tiff", ".webp"]), chance.choice([3000, 9900])
    data = cv2.imencode(kind, np.zeros((side, side), np.uint8))[1].reshape(-1)
    fields = {"header": header(START_NS, "c0"), "format": kind[1:], "data": data}
    return _cameras(4, 4, "image/compressed", COMPRESSED, side, serialize(COMPRESSED, fields))


def videos(chance: Random) -> Messages:
    """Videos of large images on several topics."""
    side, topics = chance.choice([2048, 5600]), chance.choice([2, 8])
    packets = encode([np.zeros((side, side, 3), np.uint8)] * 3, preset="ultrafast", x264_params="ref=16")
    shots: list[Fields] = [
        {"timestamp": time(START_NS), "frame_id": "c0", "data": packet.data, "format": "h264"} for packet in packets
    ]
    return _cameras(topics, len(shots), "video", VIDEO, side, *(serialize(VIDEO, fields) for fields in shots))


def many_boxes(chance: Random) -> Messages:
    """Hundreds of thousands of boxes in a message."""
    count = chance.choice([1000, 30_000, 300_000])
    one = detection2d_array([[1, 1, 9, 9]], class_names=["car"], scores=[0.9], stamp_ns=START_NS, frame_id="c0")
    head, first, both = (serialize(BOXES, {**one, "detections": one["detections"] * n}) for n in (0, 1, 2))
    item = both[len(first) :]  # a detection with its alignment
    data = head[:-4] + struct.pack("<I", count) + first[len(head) :] + item * (count - 1)
    return _cameras(1, 5, "detections", BOXES, 640, data)


def many_transforms(chance: Random) -> Messages:
    """A tree of transforms with a million frames, or a chain of them."""
    count, is_chain, is_static = chance.choice([1000, 200_000]), chance.random() < 0.5, chance.random() < 0.5
    parents = ["base_link", *(f"f{i}" if is_chain else "base_link" for i in range(999))]
    links = [transform_stamped(parent, f"f{i}", stamp_ns=START_NS) for i, parent in enumerate(parents)]
    yield _statics(["lidar"])
    for part in range(count // 1000):
        data = serialize(TF, tf_message(links)).replace(b"\0f", b"\0" + bytes([97 + part % 26]))
        data = data.replace(b"f9", f"g{part % 10}".encode())
        yield RawMessage(0, START_NS + part, (0, 0), data, channel("/tf_static" if is_static else "/tf", TF))
    yield from _clouds()


def tiny_messages(chance: Random) -> Messages:
    """Hundreds of thousands of tiny messages, in chunks that overlap in time or not."""
    count, overlaps = chance.choice([100_000, 900_000]), chance.random() < 0.5
    text = serialize("std_msgs/msg/String", {"data": "a"})
    source = channel("/text", "std_msgs/msg/String")
    yield from _clouds()
    for number in range(count):
        time_ns = START_NS + (number % 1000 if overlaps else number)
        yield RawMessage(time_ns, time_ns, (0, 0), text, source)


def poses_without_end(chance: Random) -> Messages:
    """Hundreds of thousands of poses at one time, or far apart."""
    count, step_ns = chance.choice([10_000, 200_000]), chance.choice([0, 1, 10**12])
    base = serialize(ODOMETRY, odometry(stamp_ns=START_NS, child_frame_id="base_link"))
    source = channel("/odom", ODOMETRY)
    yield _statics(["lidar"])
    for number, cloud in enumerate(_clouds()):
        yield cloud
        for part in range(count // 3):
            stamp_ns = START_NS + part * step_ns
            stamp = struct.pack("<iI", (stamp_ns // 10**9) % 2**31, stamp_ns % 10**9)
            yield RawMessage(0, _at(number) + part, (0, 0), base[:4] + stamp + base[12:], source)


# --- containers


def _zstd_of(parts: Iterable[bytes]) -> bytes:
    chunker: Any = zstandard.ZstdCompressor(write_content_size=False).chunker()
    return b"".join([*(out for part in parts for out in chunker.compress(part)), *chunker.finish()])


def compressed_database(chance: Random, folder: Path) -> list[Path]:
    """A compressed database of rows of a hundred megabytes of zeros."""
    plain, path = folder / "plain.db3", folder / "a.db3.zstd"
    size, count = chance.choice([(20 * MIB, 30), (200 * MIB, 5)])
    with closing(sqlite3.connect(plain)) as file:
        file.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        file.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        file.execute("INSERT INTO topics VALUES(1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr')")
        for number in range(count):
            file.execute("INSERT INTO messages VALUES(?, 1, ?, zeroblob(?))", (number + 1, _at(number), size))
        file.commit()
    data = plain.read_bytes()
    plain.unlink()
    path.write_bytes(_zstd_of(data[at : at + MIB] for at in range(0, len(data), MIB)))
    return [path]


def capture_of_many_lidars(chance: Random, folder: Path) -> list[Path]:
    """A network capture of packets of nothing: many senders, sizes that lie."""
    out = io.BytesIO()
    out.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
    for number in range(chance.choice([1000, 50_000])):
        source = struct.pack(">I", number)
        ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 1234, 0, 0, 64, 17, 0, source, b"\xff" * 4)
        data = bytes(12) + b"\x08\x00" + ip + struct.pack(">HHHH", 2368, 2368, 1214, 0) + bytes(1206)
        out.write(struct.pack("<IIII", 1_700_000_000, number, len(data), len(data)) + data)
    path = folder / "a.pcap.zstd"
    path.write_bytes(zstandard.compress(out.getvalue()))
    return [path]


def _written(hostile: Callable[[Random], Messages], chance: Random, folder: Path) -> list[Path]:
    """An MCAP file of messages, of which no more than a chunk is held."""
    write_mcap(folder / "a.mcap", hostile(chance), "zstd", chunk_bytes=2 * MIB)
    return [folder / "a.mcap"]


MESSAGES = (
    clouds_of_many_points,
    raw_images,
    compressed_images,
    videos,
    many_boxes,
    many_transforms,
    tiny_messages,
    poses_without_end,
)
CONTAINERS = (compressed_database, capture_of_many_lidars)
HOSTILE: dict[str, Hostile] = {
    **{one.__name__.replace("_", " "): partial(_written, one) for one in MESSAGES},
    **{one.__name__.replace("_", " "): one for one in CONTAINERS},
}
