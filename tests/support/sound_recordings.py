"""Small sound recordings in every container and compression, with the messages in them: what damage is tried on.

A recording is the files of a folder, so that a copy of it can be altered and written anew in a moment.
"""

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple

import numpy as np
import zstandard
from builders import image, odometry, raw, time, write_mcap, write_rosbag1, write_rosbag2
from captures import capture_of, interface, ng_packet, pcap, section
from mcap.writer import IndexType

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.open import open_recording
from lidcam.readers.recording import Loss, ReadOptions

T0_NS = 1_700_000_000 * 10**9
ODOMETRY, IMAGE, STAMP = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Image", "builtin_interfaces/msg/Time"

Recovery = Literal["none", "as_needed", "full_scan"]

_CHECKED = "rosbag1-bz2 mcap-none mcap-lz4 mcap-zstd mcap-no-summary mcap-no-message-index mcap-no-chunk-index"
_OTHERS = """
rosbag1-none rosbag1-lz4 mcap-no-crc mcap-no-chunks mcap-no-chunks-no-crc sqlite sqlite-old sqlite-wal sqlite-zstd
folder-sqlite folder-sqlite-message folder-sqlite-file folder-mcap pcap pcapng
"""
CHECKED = frozenset(_CHECKED.split())
"""Kinds in which a checksum covers every message."""

KINDS = (*_CHECKED.split(), *_OTHERS.split())


class Seen(NamedTuple):
    """One message as it is read; its name is its topic and its type."""

    name: tuple[str, str]
    definition: str
    log_time_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class SoundRecording:
    """A recording and what is in it."""

    kind: str
    files: Mapping[str, bytes]
    opened: str
    messages: tuple[Seen, ...]
    told: frozenset[str]


def sound_recording(kind: str) -> SoundRecording:
    """The recording of a kind: a drive of 45 messages."""
    with TemporaryDirectory(prefix="sound-") as name:
        folder = Path(name)
        opened = _write(folder, kind)
        base = folder / opened
        root = base.parent if base.is_file() else base
        files = {file.name: file.read_bytes() for file in sorted(root.iterdir()) if not file.name.endswith("-shm")}
        opened = base.name if base.is_file() else ""
        messages, losses = read_all(root / opened, "as_needed")
    told = frozenset(loss.reason for loss in losses)
    return SoundRecording(kind, files, opened, messages, told)


def write_files(folder: Path, recording: SoundRecording, files: Mapping[str, bytes]) -> Path:
    """Write files of a recording into an empty folder; returns the path to open."""
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder / recording.opened


def read_all(path: Path, recovery: Recovery) -> tuple[tuple[Seen, ...], tuple[Loss, ...]]:
    """All messages of a recording, and its losses; topics that are listed as unreadable count as such."""
    with open_recording([path], ReadOptions(recovery)) as recording:
        seen = tuple(
            Seen((m.topic, m.channel.msgtype), str(m.channel.definition), m.log_time_ns, bytes(m.data))
            for m in recording.messages()
        )
        unreadable = [info for info in recording.topics if info.unreadable and info.message_count]
        return seen, recording.losses + tuple(Loss(path, 0, f"{info.topic}: {info.unreadable}") for info in unreadable)


def _messages(encoding: Literal["ros1", "cdr"]) -> list[RawMessage]:
    """States, images that no compressor makes smaller, and short messages, not all from the beginning on."""
    noise = np.random.default_rng(5)
    messages = []
    for i in range(24):
        at = T0_NS + i * 10**8
        messages.append(raw("/odom", ODOMETRY, odometry(stamp_ns=at, position=(i, 0, 0)), at, at, encoding))
        if i % 4 == 0:
            content = image(noise.integers(0, 255, (14, 30, 3), np.uint8), stamp_ns=at)
            messages.append(raw("/image", IMAGE, content, at, at + 1, encoding))
        if i > 8:  # begins in a later chunk
            messages.append(raw("/tick", STAMP, time(at), at, at + 2, encoding))
    return messages


def _write(folder: Path, kind: str) -> str:
    """Write a recording; returns what is opened, relative to `folder`."""
    form, _, how = kind.partition("-")
    if form == "rosbag1":
        compression: Any = how
        write_rosbag1(folder / "rec.bag", _messages("ros1"), compression, chunk_bytes=5000)
        return "rec.bag"
    if form == "mcap":
        _write_mcap(folder / "rec.mcap", how)
        return "rec.mcap"
    if form == "pcap" or form == "pcapng":
        return _write_capture(folder, form)
    options: Any = {"folder-sqlite-message": "message", "folder-sqlite-file": "file", "folder-mcap": "storage"}
    compression = options.get(kind, "none")
    write_rosbag2(folder / "rec", _messages("cdr"), "mcap" if how == "mcap" else "sqlite3", compression)
    if form == "folder":
        return "rec"
    (folder / "rec" / "metadata.yaml").unlink()
    return _write_database(folder / "rec", how)


def _write_mcap(path: Path, how: str) -> None:
    compression: Any = how if how in {"none", "lz4", "zstd"} else "none"
    parts_of_summary = "use_statistics", "use_summary_offsets", "repeat_channels", "repeat_schemas"
    every: dict[str, dict[str, Any]] = {
        "no-crc": {"enable_crcs": False},
        "no-summary": dict.fromkeys(parts_of_summary, False) | {"index_types": IndexType.NONE},
        "no-message-index": {"index_types": IndexType.CHUNK},
        "no-chunk-index": {"index_types": IndexType.MESSAGE},
        "no-chunks": {"use_chunking": False, "enable_data_crcs": True},
        "no-chunks-no-crc": {"use_chunking": False, "enable_crcs": False},
    }
    write_mcap(path, _messages("cdr"), compression, chunk_bytes=5000, **every.get(how, {}))


def _write_capture(folder: Path, form: str) -> str:
    payload = np.random.default_rng(6).integers(0, 255, (24, 1206), np.uint8)
    stamps_ns = T0_NS + np.arange(24, dtype=np.int64) * 1_327_000
    packets = sorted(
        capture_of(payload[::2], stamps_ns[::2]) + capture_of(payload[1::2], stamps_ns[1::2], "192.168.1.202")
    )
    if form == "pcap":
        (folder / "rec.pcap").write_bytes(pcap(packets))
        return "rec.pcap"
    blocks = [ng_packet(at, packet) for at, packet in packets]
    (folder / "rec.pcapng").write_bytes(b"".join([section(), interface(), *blocks]))
    return "rec.pcapng"


def _write_database(folder: Path, how: str) -> str:
    path = folder / "rec.db3"
    if how == "old":  # as ROS 2 Foxy wrote it
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("DROP TABLE message_definitions")
            database.execute("DROP TABLE schema")
            database.execute("DROP TABLE metadata")
            database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    elif how == "wal":
        first, step = 21, 5
        with closing(sqlite3.connect(path, isolation_level=None)) as database:
            database.execute("PRAGMA journal_mode=WAL")
            database.execute(f"CREATE TABLE later AS SELECT * FROM messages WHERE id >= {first}")
            database.execute(f"DELETE FROM messages WHERE id >= {first}")
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            database.execute("PRAGMA wal_autocheckpoint=0")
            for row in range(first, 60, step):
                between = f"id BETWEEN {row} AND {row + step - 1}"
                database.execute(f"INSERT INTO messages SELECT * FROM later WHERE {between}")
            left = {file.name: file.read_bytes() for file in folder.iterdir() if not file.name.endswith("-shm")}
        for name, content in left.items():
            (folder / name).write_bytes(content)
    elif how == "zstd":
        packed = zstandard.ZstdCompressor(write_checksum=True).compress(path.read_bytes())
        path.unlink()
        path = path.with_suffix(".db3.zstd")
        path.write_bytes(packed)
    return f"rec/{path.name}"
