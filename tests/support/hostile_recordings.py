"""Small recordings that ask for a lot of memory, disk or time: one function for each way, in `HOSTILE`.

Each writes a recording of at most a few hundred kilobytes into a folder and returns what to read of it. Their sizes are
up to `Random`, around the limits of the settings: some are refused, some are just within.
"""

import io
import json
import sqlite3
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from random import Random
from typing import Any, Literal

import cv2
import numpy as np
import zstandard
from builders import (
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
    write_mcap,
    write_rosbag1,
)
from mcap.data_stream import RecordBuilder
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from pipeline.core.messages import Channel, RawMessage

__all__ = ["HOSTILE", "Hostile"]

Hostile = Callable[[Random, Path], list[Path]]

MIB = 1 << 20
PERIOD_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000
CLOUD, IMAGE, COMPRESSED = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
TF, BOXES = "tf2_msgs/msg/TFMessage", "vision_msgs/msg/Detection2DArray"
BIG_CHUNK = 1 << 40


def _at(message: RawMessage, number: int) -> RawMessage:
    """A message as the one of another time; its stamp is that of its header, which is not changed."""
    return message._replace(log_time_ns=START_NS + number * PERIOD_NS)


def _cloud(
    topic: str,
    number: int,
    points: Any = ((5, 1, 0), (6, 1, 0), (7, 2, 1)),
    frame_id: str = "lidar",
    encoding: Literal["ros1", "cdr"] = "cdr",
) -> RawMessage:
    stamp_ns = START_NS + number * PERIOD_NS
    body = pointcloud2(points, stamp_ns=stamp_ns, frame_id=frame_id)
    return raw(topic, CLOUD, body, stamp_ns, encoding=encoding)


def _info(camera: str, number: int, width_px: int = 640, height_px: int = 480) -> RawMessage:
    stamp_ns = START_NS + number * PERIOD_NS
    k = np.array([[500, 0, width_px / 2], [0, 500, height_px / 2], [0, 0, 1]])
    info = camera_info(k, stamp_ns=stamp_ns, width_px=width_px, height_px=height_px, frame_id=camera)
    return raw(f"/{camera}/camera_info", "sensor_msgs/msg/CameraInfo", info, stamp_ns)


def _statics(frames: Iterable[str]) -> RawMessage:
    links = [
        transform_stamped("base_link", name, stamp_ns=START_NS, rotation_xyzw=(-0.5, 0.5, -0.5, 0.5)) for name in frames
    ]
    return raw("/tf_static", TF, tf_message(links), START_NS)


def _write(path: Path, messages: Iterable[RawMessage], *, chunk_bytes: int = BIG_CHUNK, bag: str = "") -> list[Path]:
    if bag:
        write_rosbag1(path.with_suffix(".bag"), messages, bag, chunk_bytes=chunk_bytes)  # type: ignore[arg-type]
        return [path.with_suffix(".bag")]
    _write_lazily(path.with_suffix(".mcap"), messages, chunk_bytes)
    return [path.with_suffix(".mcap")]


def _write_lazily(path: Path, messages: Iterable[RawMessage], chunk_bytes: int) -> None:
    """As `write_mcap`, in one chunk after the other, without a list of all messages."""
    with path.open("xb") as stream:
        writer = McapWriter(stream, chunk_bytes, CompressionType.ZSTD)
        writer.start("ros2", "lidcam tests")
        ids: dict[Channel, int] = {}
        for sequence, message in enumerate(messages):
            source = message.channel
            if source not in ids:
                schema = writer.register_schema(source.msgtype, source.definition_format, source.definition.encode())
                ids[source] = writer.register_channel(source.topic, source.encoding, schema)
            writer.add_message(ids[source], message.log_time_ns, bytes(message.data), message.log_time_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def _many_points(chance: Random, count: int) -> np.ndarray[Any, Any]:
    """Points that compress well and lie apart from one another: a pattern, again and again."""
    kind = chance.choice(["zeros", "one", "pattern"])
    if kind == "zeros":
        return np.zeros((count, 3), np.float32)
    if kind == "one":
        return np.full((count, 3), 3, np.float32)
    pattern = np.random.default_rng(chance.randrange(1000)).uniform(-50, 50, (3000, 3)).astype(np.float32)
    return np.resize(pattern, (count, 3))


# --- clouds and images


def clouds_of_many_points(chance: Random, folder: Path) -> list[Path]:
    """Several lidars with up to ten million points in each sweep."""
    lidars, count = chance.choice([1, 4, 12]), chance.choice([1_000_000, 3_000_000, 9_999_999])
    points = _many_points(chance, count)
    first = _cloud("/l0/points", 0, points, "l0")

    def messages() -> Iterator[RawMessage]:
        yield _statics([f"l{i}" for i in range(lidars)])
        for number in range(3):
            for lidar in range(lidars):
                cloud = _cloud(f"/l{lidar}/points", number, frame_id=f"l{lidar}")
                head = serialize(
                    CLOUD, pointcloud2(np.zeros((0, 3), np.float32), stamp_ns=cloud.stamp_ns, frame_id=f"l{lidar}")
                )
                data = bytearray(first.data)
                data[:20] = head[:20]  # the stamp, and the length and first letters of the frame
                data[16 : 16 + 3] = f"l{lidar}\0".encode()[:3]
                yield cloud._replace(data=bytes(data))

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


def clouds_that_wait(chance: Random, folder: Path) -> list[Path]:
    """Large clouds of one lidar that wait for another one, which never comes."""
    big = _cloud("/a/points", 0, _many_points(chance, chance.choice([2_000_000, 9_000_000])), "a")

    def messages() -> Iterator[RawMessage]:
        yield _statics(["a", "b"])
        yield _cloud("/b/points", 0, frame_id="b")
        for number in range(12):
            head = struct.pack("<iI", *divmod(START_NS + number * PERIOD_NS, 10**9))
            yield _at(big, number)._replace(data=b"\0\1\0\0" + head + bytes(big.data[12:]))
        yield _cloud("/b/points", 30, frame_id="b")

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


def raw_images(chance: Random, folder: Path) -> list[Path]:
    """Raw images of up to a hundred million pixels of several cameras, plain."""
    cameras, side = chance.choice([1, 8]), chance.choice([4000, 9900])
    pixels = np.zeros((side, side), np.uint8)
    first = raw("/c0/image", IMAGE, image(pixels, stamp_ns=START_NS, frame_id="c0", encoding="mono8"), START_NS)

    def messages() -> Iterator[RawMessage]:
        yield _statics(["lidar", *(f"c{i}" for i in range(cameras))])
        for camera in range(cameras):
            yield _info(f"c{camera}", 0, side, side)
        for number in range(3):
            yield _cloud("/points", number)
            for camera in range(cameras):
                stamp = struct.pack("<iI", *divmod(START_NS + number * PERIOD_NS, 10**9))
                data = b"\0\1\0\0" + stamp + bytes(first.data[12:])
                one = first._replace(data=data, channel=channel(f"/c{camera}/image", IMAGE))
                yield _at(one, number)

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


def _packed_image(kind: str, side: int) -> bytes:
    pixels = np.zeros((side, side), np.uint8)
    done, data = cv2.imencode(kind, pixels)
    assert done
    return data.tobytes()


def compressed_images(chance: Random, folder: Path) -> list[Path]:
    """JPEG, PNG, WebP and TIFF of nearly a hundred million pixels."""
    kind, side = chance.choice([".jpg", ".png", ".tiff", ".webp"]), chance.choice([3000, 9900])
    data = np.frombuffer(_packed_image(kind, side), np.uint8)

    def messages() -> Iterator[RawMessage]:
        yield _statics(["lidar", "c0", "c1", "c2", "c3"])
        for camera in range(4):
            yield _info(f"c{camera}", 0, side, side)
        for number in range(4):
            yield _cloud("/points", number)
            for camera in range(4):
                stamp_ns = START_NS + number * PERIOD_NS
                fields = {"header": header(stamp_ns, f"c{camera}"), "format": kind[1:], "data": data}
                yield raw(f"/c{camera}/image/compressed", COMPRESSED, fields, stamp_ns)

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


def videos(chance: Random, folder: Path) -> list[Path]:
    """Videos of large images on several topics."""
    import av

    side, topics = chance.choice([2048, 5600]), chance.choice([2, 8])
    context: Any = av.CodecContext.create("libx264", "w")
    context.width = context.height = side
    context.pix_fmt, context.options = (
        "yuv420p",
        {"preset": "ultrafast", "tune": "zerolatency", "x264-params": "ref=16"},
    )
    context.framerate = 10
    context.time_base = Fraction(1, 10)
    frame = av.VideoFrame.from_ndarray(np.zeros((side, side, 3), np.uint8), format="bgr24").reformat(format="yuv420p")
    packets = []
    for number in range(3):
        frame.pts = number
        packets += [bytes(packet) for packet in context.encode(frame)]
    packets += [bytes(packet) for packet in context.encode(None)]

    def messages() -> Iterator[RawMessage]:
        yield _statics(["lidar", *(f"c{i}" for i in range(topics))])
        for camera in range(topics):
            yield _info(f"c{camera}", 0, side, side)
        for number, data in enumerate(packets):
            yield _cloud("/points", number)
            for camera in range(topics):
                stamp_ns = START_NS + number * PERIOD_NS
                fields = {
                    "timestamp": header(stamp_ns, "")["stamp"],
                    "frame_id": f"c{camera}",
                    "data": np.frombuffer(data, np.uint8),
                    "format": "h264",
                }
                yield raw(f"/c{camera}/video", "foxglove_msgs/msg/CompressedVideo", fields, stamp_ns)

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


# --- lists


def many_boxes(chance: Random, folder: Path) -> list[Path]:
    """Hundreds of thousands of boxes in a message."""
    count = chance.choice([1000, 30_000, 300_000])
    one = detection2d_array([[1, 1, 9, 9]], class_names=["car"], scores=[0.9], stamp_ns=START_NS, frame_id="c0")
    head = serialize(BOXES, {**one, "detections": []})
    body = serialize(BOXES, one)[len(head) :]
    two = serialize(BOXES, {**one, "detections": one["detections"] * 2})[len(head) :]
    item = two[len(body) :]  # a detection with its alignment

    def messages() -> Iterator[RawMessage]:
        yield _statics(["lidar", "c0"])
        yield _info("c0", 0)
        for number in range(5):
            yield _cloud("/points", number)
            data = head[:-4] + struct.pack("<I", count) + body + item * (count - 1)
            stamp = struct.pack("<iI", *divmod(START_NS + number * PERIOD_NS, 10**9))
            message = RawMessage(0, 0, (0, 0), data[:4] + stamp + data[12:], channel("/c0/detections", BOXES))
            yield _at(message, number)

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


def many_transforms(chance: Random, folder: Path) -> list[Path]:
    """A tree of transforms with a million frames, or a chain of them."""
    count, is_chain, is_static = chance.choice([1000, 200_000]), chance.random() < 0.5, chance.random() < 0.5
    links = [
        transform_stamped(f"f{i - 1}" if is_chain and i else "base_link", f"f{i}", stamp_ns=START_NS)
        for i in range(1000)
    ]

    def messages() -> Iterator[RawMessage]:
        yield _statics(["lidar"])
        topic = "/tf_static" if is_static else "/tf"
        for part in range(count // 1000):
            data = serialize(TF, tf_message(links)).replace(b"\0f", b"\0" + bytes([97 + part % 26]))
            data = data.replace(b"f9", f"g{part % 10}".encode())
            yield RawMessage(0, START_NS + part, (0, 0), data, channel(topic, TF))
        for number in range(3):
            yield _cloud("/points", number)

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


def tiny_messages(chance: Random, folder: Path) -> list[Path]:
    """Hundreds of thousands of tiny messages, in chunks that overlap in time or not."""
    count, overlaps = chance.choice([100_000, 900_000]), chance.random() < 0.5
    text = serialize("std_msgs/msg/String", {"data": "a"})
    source = channel("/text", "std_msgs/msg/String")

    def messages() -> Iterator[RawMessage]:
        for number in range(3):
            yield _cloud("/points", number)
        for number in range(count):
            time_ns = START_NS + (number % 1000 if overlaps else number)
            yield RawMessage(time_ns, time_ns, (0, 0), text, source)

    return _write(folder / "a", messages(), chunk_bytes=chance.choice([MIB, 20 * MIB]))


def tiny_clouds(chance: Random, folder: Path) -> list[Path]:
    """Tens of thousands of empty clouds of many lidars."""
    lidars, count = chance.choice([1, 200]), chance.choice([2000, 8000])

    def messages() -> Iterator[RawMessage]:
        yield _statics([f"l{i}" for i in range(lidars)])
        for number in range(count // lidars):
            for lidar in range(lidars):
                yield _cloud(f"/l{lidar}/points", number, frame_id=f"l{lidar}")

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


def many_topics(chance: Random, folder: Path) -> list[Path]:
    """A thousand topics, each with a long definition of its own."""
    count, fields = chance.choice([900, 5000]), chance.choice([10, 3000])

    def messages() -> Iterator[RawMessage]:
        for number in range(3):
            yield _cloud("/points", number)
        for topic in range(count):
            text = "\n".join(f"float64 value_{topic}_{i}" for i in range(fields))
            source = Channel(f"/t{topic}", f"a/msg/A{topic}", "cdr", text, "ros2msg")
            yield RawMessage(START_NS, START_NS, (0, 0), b"\0\1\0\0" + bytes(8 * fields), source)

    return _write(folder / "a", messages())


def lists_of_nothing(chance: Random, folder: Path) -> list[Path]:
    """Lists of billions of elements that take no bytes, or nested definitions."""
    text = chance.choice(
        [
            "std_msgs/Header header\nB[] b\n" + "=" * 80 + "\nMSG: a/B\n",
            "std_msgs/Header header\nB[4000000000] b\n" + "=" * 80 + "\nMSG: a/B\nuint8 x",
            "std_msgs/Header header\nstring[] b",
            "std_msgs/Header header\nwstring[] b",
            "std_msgs/Header header\nuint8[] b",
        ]
    )

    def messages() -> Iterator[RawMessage]:
        for number in range(3):
            yield _cloud("/points", number)
        source = Channel("/points2", CLOUD, "cdr", text, "ros2msg")
        data = (
            serialize("std_msgs/msg/Header", header(START_NS, "lidar"))
            + b"\0\0"
            + struct.pack("<I", 2**32 - 1)
            + bytes(MIB)
        )
        for number in range(20):
            yield RawMessage(0, START_NS + number * PERIOD_NS, (0, 0), data, source)

    return _write(folder / "a", messages())


def nested_json(chance: Random, folder: Path) -> list[Path]:
    """JSON of lists in lists, or of millions of small objects."""
    kind = chance.choice(["deep", "wide", "number"])
    data = {
        "deep": b'{"fields":' + b"[" * 5_000_000,
        "wide": b'{"fields":[' + b"{}," * 10_000_000 + b"{}]}",
        "number": b'{"point_stride":' + b"9" * 20_000_000 + b"}",
    }[kind]
    source = Channel("/points", "foxglove.PointCloud", "json", "{}", "jsonschema")

    def messages() -> Iterator[RawMessage]:
        for number in range(3):
            yield RawMessage(0, START_NS + number * PERIOD_NS, (0, 0), data, source)

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


# --- containers


def _zstd_of(parts: Iterable[bytes]) -> bytes:
    chunker: Any = zstandard.ZstdCompressor(write_content_size=False).chunker()
    return b"".join([*(out for part in parts for out in chunker.compress(part)), *chunker.finish()])


def compressed_file(chance: Random, folder: Path) -> list[Path]:
    """A file that unpacks to gigabytes of zeros behind its first bytes."""
    magic = chance.choice([b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\0", b"\xd4\xc3\xb2\xa1" + bytes(20)])
    mib = chance.choice([100, 1500])
    path = folder / "a.mcap.zstd"
    path.write_bytes(_zstd_of([magic, *([bytes(MIB)] * mib)]))
    return [path]


def compressed_database(chance: Random, folder: Path) -> list[Path]:
    """A compressed database of rows of a hundred megabytes of zeros."""
    plain = folder / "plain.db3"
    size, count = chance.choice([(20 * MIB, 30), (200 * MIB, 5)])
    with closing(sqlite3.connect(plain)) as file:
        file.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        file.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        file.execute("INSERT INTO topics VALUES(1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr')")
        for number in range(count):
            file.execute(
                "INSERT INTO messages VALUES(?, 1, ?, zeroblob(?))", (number + 1, START_NS + number * PERIOD_NS, size)
            )
        file.commit()
    data = plain.read_bytes()
    plain.unlink()
    path = folder / "a.db3.zstd"
    path.write_bytes(_zstd_of(data[at : at + MIB] for at in range(0, len(data), MIB)))
    return [path]


def chunks_of_zeros(chance: Random, folder: Path) -> list[Path]:
    """Chunks of a quarter of a gigabyte with one large message each, that overlap in time."""
    topics = chance.choice([1, 8])
    mib = chance.choice([60, 250])
    points = mib * MIB // 12

    def messages() -> Iterator[RawMessage]:
        yield _statics([f"l{i}" for i in range(topics)])
        for number in range(12):
            stamp_ns = START_NS + number * PERIOD_NS
            topic = number % topics
            empty = pointcloud2(np.zeros((0, 3), np.float32), stamp_ns=stamp_ns, frame_id=f"l{topic}")
            head = serialize(CLOUD, {**empty, "width": points})
            data = head[:-5] + struct.pack("<I", points * 12) + bytes(points * 12 + 1)
            yield RawMessage(stamp_ns, START_NS, (0, 0), data, channel(f"/l{topic}/points", CLOUD))

    return _write(folder / "a", messages(), chunk_bytes=MIB)


def sizes_that_lie(chance: Random, folder: Path) -> list[Path]:
    """Records of an MCAP file or a bag that claim sizes of gigabytes to exabytes."""
    claimed = chance.choice([2**31 - 1, 2**32 - 1, 2**40, 2**62, 2**63 + 5])
    bag = chance.choice(["", "none", "lz4"])
    clouds = [_cloud("/points", number, encoding="ros1" if bag else "cdr") for number in range(5)]
    paths = _write(folder / "a", clouds, chunk_bytes=100, bag=bag)
    data = bytearray(paths[0].read_bytes())
    for _ in range(chance.randrange(1, 4)):
        at = chance.randrange(8, len(data) - 8)
        size = struct.pack("<Q", claimed) if paths[0].suffix == ".mcap" else struct.pack("<I", claimed & 0xFFFFFFFF)
        data[at : at + len(size)] = size
    paths[0].write_bytes(data)
    return paths


def attachments_and_statistics(chance: Random, folder: Path) -> list[Path]:
    """An MCAP file whose summary holds a million records: statistics, channels, attachments or metadata."""
    path = folder / "a.mcap"
    count = chance.choice([10_000, 300_000])
    kind = chance.choice(["chunks", "channels", "metadata", "statistics"])
    write_mcap(path, [_cloud("/points", number) for number in range(5)], "none")
    data = path.read_bytes()
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    builder: Any = RecordBuilder()
    for schema in summary.schemas.values():
        schema.write(builder)
    for found in summary.channels.values():
        found.write(builder)
    for number in range(count if kind == "channels" else 0):
        replace(next(iter(summary.channels.values())), id=2 + number % 60_000, topic=f"/t{number}").write(builder)
    for number in range(count if kind == "chunks" else 1):
        replace(
            summary.chunk_indexes[0], chunk_start_offset=summary.chunk_indexes[0].chunk_start_offset + number
        ).write(builder)
    for _ in range(count if kind == "metadata" else 0):
        builder.start_record(12)
        builder.write(struct.pack("<II", 1, 0) + b"a" + struct.pack("<I", 0))
        builder.finish_record()
    counts = dict.fromkeys(range(min(count, 65000)), 1) if kind == "statistics" else {1: 5}
    assert summary.statistics is not None
    replace(summary.statistics, channel_message_counts=counts, chunk_count=count if kind == "chunks" else 1).write(
        builder
    )
    body = builder.end()
    start = struct.unpack("<Q", data[-28:-20])[0]
    footer = struct.pack("<BQQQI", 2, 20, start, 0, 0)
    path.write_bytes(data[:start] + body + footer + data[-8:])
    return [path]


def bag_of_many_connections(chance: Random, folder: Path) -> list[Path]:
    """A bag whose header names billions of connections and chunks, or whose index lists a message again and again."""
    (path,) = _write(folder / "a", [_ros1_text(number) for number in range(100)], bag=chance.choice(["none", "lz4"]))
    data = path.read_bytes()
    name = chance.choice([b"conn_count=", b"chunk_count=", b"count=", b"size="])
    at = data.find(name, 0 if name != b"count=" else 4117)
    data = data[: at + len(name)] + struct.pack("<I", chance.choice([2**32 - 1, 2**24])) + data[at + len(name) + 4 :]
    path.write_bytes(data)
    return [path]


def _ros1_text(number: int) -> RawMessage:
    time_ns = START_NS + number * PERIOD_NS
    return raw("/points", CLOUD, pointcloud2([[1, 2, 3]], stamp_ns=time_ns), time_ns, encoding="ros1")


def folder_of_many_files(chance: Random, folder: Path) -> list[Path]:
    """A folder whose metadata name a hundred thousand files, or YAML of aliases."""
    write_mcap(folder / "a_0.mcap", [_cloud("/points", number) for number in range(3)])
    if chance.random() < 0.5:
        names = json.dumps(["a_0.mcap"] * chance.choice([100, 100_000]))
        text = f"rosbag2_bagfile_information: {{relative_file_paths: {names}}}"
    else:
        levels = "\n".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30))
        text = f"a0: &a0 [x]\n{levels}\nrosbag2_bagfile_information: {{relative_file_paths: *a29}}"
    (folder / "metadata.yaml").write_text(text)
    return [folder]


def poses_without_end(chance: Random, folder: Path) -> list[Path]:
    """Hundreds of thousands of poses at one time, or far apart."""
    count, step_ns = chance.choice([10_000, 200_000]), chance.choice([0, 1, 10**12])

    def messages() -> Iterator[RawMessage]:
        yield _statics(["lidar"])
        base = serialize("nav_msgs/msg/Odometry", odometry(stamp_ns=START_NS, child_frame_id="base_link"))
        for number in range(3):
            yield _cloud("/points", number)
            for part in range(count // 3):
                stamp_ns = START_NS + part * step_ns
                stamp = struct.pack("<iI", (stamp_ns // 10**9) % 2**31, stamp_ns % 10**9)
                data = base[:4] + stamp + base[12:]
                yield RawMessage(
                    0, START_NS + number * PERIOD_NS + part, (0, 0), data, channel("/odom", "nav_msgs/msg/Odometry")
                )

    return _write(folder / "a", messages(), chunk_bytes=2 * MIB)


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


HOSTILE: dict[str, Hostile] = {
    function.__name__.replace("_", " "): function
    for function in (
        lists_of_nothing,
        clouds_of_many_points,
        clouds_that_wait,
        raw_images,
        compressed_images,
        videos,
        many_boxes,
        many_transforms,
        tiny_messages,
        tiny_clouds,
        many_topics,
        nested_json,
        compressed_file,
        compressed_database,
        chunks_of_zeros,
        sizes_that_lie,
        attachments_and_statistics,
        bag_of_many_connections,
        folder_of_many_files,
        poses_without_end,
        capture_of_many_lidars,
    )
}
