"""Files that ask for more than they are worth: one clear line, and a bounded amount of memory."""

import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal
from unittest.mock import Mock

import pytest
import zstandard
from builders import (
    odometry,
    raw,
    tf_message,
    transform_stamped,
    write_mcap,
    write_recording,
    write_rosbag1,
    write_rosbag2,
)
from helpers import MIB, at_most
from memory_recording import MemoryRecording

from lidcam.pipeline.core.errors import FrameError, MessageError, RecordingError, ShortMemoryError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.files.damage import Losses
from lidcam.readers.messages.deserialize import definition_problem, deserialize
from lidcam.readers.messages.tf import read_transforms
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions

ODOMETRY = "nav_msgs/msg/Odometry"
Encoding = Literal["ros1", "cdr"]


def states(count: int, encoding: Encoding = "cdr", *, frame_id: str = "odom") -> list[RawMessage]:
    return [
        raw("/odom", ODOMETRY, odometry(stamp_ns=i, frame_id=frame_id), i, i, encoding) for i in range(1, count + 1)
    ]


def read(
    path: Path, limits: RecordingLimits = DEFAULT_LIMITS, *, thorough: bool = False
) -> tuple[list[int], list[str]]:
    """Log times that are read, and what was lost."""
    with open_recording([path], ReadOptions("full_scan" if thorough else "as_needed", limits)) as recording:
        times = [message.log_time_ns for message in recording.messages()]
        return times, [loss.reason for loss in recording.losses]


def packed_zeros(mib: int) -> bytes:
    chunker: Any = zstandard.ZstdCompressor(write_content_size=False).chunker()
    return b"".join([*(part for _ in range(mib) for part in chunker.compress(bytes(MIB))), *chunker.finish()])


# --- compressed as a whole, or message by message


@pytest.mark.parametrize("recovery", ["as_needed", "none"])
def test_a_file_that_would_fill_the_disk(tmp_path: Path, recovery: Literal["as_needed", "none"]) -> None:
    path = tmp_path / "a.mcap.zstd"
    path.write_bytes(packed_zeros(64))
    with at_most(10), pytest.raises(RecordingError, match=r"a\.mcap\.zstd: unpacks to more than .* raise limit_scale"):
        open_recording([path], ReadOptions(recovery, RecordingLimits(max_unpacked_file_gib=0.01)))


@pytest.mark.parametrize("says_size", [True, False])
@pytest.mark.parametrize("plugin", ["sqlite3", "mcap"])
def test_a_message_that_unpacks_to_too_much(
    tmp_path: Path, plugin: Literal["sqlite3", "mcap"], says_size: bool
) -> None:
    small, _, last = states(3)
    bomb = small._replace(data=packed_zeros(64), log_time_ns=2)
    if says_size:
        bomb = bomb._replace(data=zstandard.compress(bytes(64 * MIB)))
    write_rosbag2(tmp_path / "rec", [small, bomb, last], plugin)
    with at_most(12):
        times, losses = read(tmp_path / "rec", RecordingLimits(max_message_bytes=2 << 20))
    assert times == [1, 3]
    assert len(losses) == 1
    assert ("limit_scale" in losses[0]) == says_size


@pytest.mark.parametrize("kind", ["bag", "loose", "sqlite"])
def test_a_message_that_is_too_large(tmp_path: Path, kind: str) -> None:
    messages = states(3, "ros1" if kind == "bag" else "cdr")
    messages[1] = messages[1]._replace(data=bytes(2 * MIB))
    times, losses = read(write_recording(tmp_path / "rec", kind, messages), RecordingLimits(max_message_bytes=1 << 20))
    assert times == [1, 3]
    assert "limit_scale" in losses[-1]


# --- chunks


@pytest.mark.parametrize("how", ["none", "zstd"])
def test_a_chunk_of_too_many_messages(tmp_path: Path, how: Literal["none", "zstd"]) -> None:
    path = tmp_path / "a.mcap"
    write_mcap(path, states(50), how, chunk_bytes=20_000)
    limits = RecordingLimits(max_messages_per_chunk=20)
    for thorough in (False, True):
        times, losses = read(path, limits, thorough=thorough)
        assert len(times) < 50
        assert "limit_scale" in losses[0]


@pytest.mark.parametrize("how", ["whole", "cut", "overlapping"])
@pytest.mark.parametrize("kind", ["bag-bz2", "mcap-zstd"])
def test_chunks_that_unpack_to_too_much(tmp_path: Path, kind: str, how: str) -> None:
    path, takes_turns = tmp_path / "a", how == "overlapping"
    messages = states(24, "ros1" if kind == "bag-bz2" else "cdr")
    messages = [m._replace(data=bytes((3 if takes_turns else 1) * MIB)) for m in messages]
    if takes_turns:  # two chunks, too large to be kept together, of which the messages take turns
        messages = [m._replace(log_time_ns=1 + i % 12 * 2 + i // 12) for i, m in enumerate(messages)]
    write_recording(path, kind, messages, chunk_bytes=(35 if takes_turns else 2) * MIB)
    if how == "cut":
        path.write_bytes(path.read_bytes()[:-1])
    limits = RecordingLimits(max_unpacked_file_gib=(150 if takes_turns else 16) / 1024)
    with pytest.raises(RecordingError, match=r"a: chunks of \d+ bytes unpack to more.* raise limit_scale"):
        read(path, limits)


def test_more_messages_than_memory_holds(tmp_path: Path) -> None:
    few = RecordingLimits(max_messages_in_memory=30, max_positions_waiting=30)
    write_mcap(tmp_path / "loose.mcap", states(50), use_chunking=False)
    overlapping = [m._replace(log_time_ns=i % 5) for i, m in enumerate(states(50))]
    write_mcap(tmp_path / "overlapping.mcap", overlapping, chunk_bytes=3000)
    write_rosbag1(tmp_path / "cut.bag", states(50, "ros1"))
    (tmp_path / "cut.bag").write_bytes((tmp_path / "cut.bag").read_bytes()[:-1])
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises(RecordingError, match=r"more than 30 messages.* raise limit_scale"):
            read(path, few)


def test_too_many_topics(tmp_path: Path) -> None:
    messages = [m._replace(channel=replace(m.channel, topic=f"/{i}")) for i, m in enumerate(states(30))]
    write_mcap(tmp_path / "a.mcap", messages)
    with pytest.raises(RecordingError, match=r"a\.mcap: 30 topics, expected at most 20: raise limit_scale"):
        open_recording([tmp_path / "a.mcap"], ReadOptions(limits=RecordingLimits(max_topics=20)))


def test_losses_are_added_up() -> None:
    losses = Losses(Path("a"), ReadOptions(limits=RecordingLimits(max_losses_listed=2)))
    for _ in range(2):
        for position in range(5):
            losses.note(position, "gone", size=10, messages=None if position == 4 else 1)
    *listed, rest = losses.listed()
    assert [loss.position for loss in listed] == [0, 1]
    assert (rest.position, rest.size, rest.messages) == (2, 30, None)
    assert rest.reason == "3 further places, see limit_scale"


# --- definitions


def described(text: str, data: bytes = bytes(1000), encoding: Encoding = "ros1") -> RawMessage:
    form: Any = "ros1msg" if encoding == "ros1" else "ros2msg"
    return RawMessage(0, 0, (0, 0), data, Channel("/a", "a/msg/A", encoding, text, form))


def parts(*texts: tuple[str, str]) -> str:
    return "".join(f"\n{'=' * 80}\nMSG: a/{name}\n{text}\n" for name, text in texts)


LAUGHS = "\n".join(f"B b{i}" for i in range(10)) + parts(
    *((chr(66 + i), "\n".join(f"{chr(67 + i)} x{j}" for j in range(10))) for i in range(8)), ("J", "uint8 x")
)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("a/A[] a", "a/msg/A contains itself"),
        ("B b" + parts(("B", "C[3] c"), ("C", "A a")), "a/msg/A contains itself"),
        ("B[] b" + parts(("B", "uint8 X=1")), "is a list of empty messages"),
        ("B[100000000] b" + parts(("B", "uint8 x")), "more than 5000 values"),
        ("string[100000000] b", "more than 5000 values"),
        (LAUGHS, "more than 5000 values"),
        ("\n".join(f"uint8 x{i}" for i in range(40_000)), "expected at most 262144"),
        (
            "B0 b" + parts(*((f"B{i}", f"B{i + 1} b") for i in range(100)), ("B100", "uint8 x")),
            "types are nested more than 50 deep",
        ),
    ],
)
def test_definitions_that_ask_for_too_much(text: str, fault: str, encoding: Encoding) -> None:
    message = described(text, encoding=encoding)
    with at_most(60):
        assert fault in definition_problem(message.channel)
        with pytest.raises(MessageError, match=fault):
            deserialize(message)


# --- transforms


def test_a_chain_of_transforms_without_end() -> None:
    links = [transform_stamped(f"f{i + 1}", f"f{i}", stamp_ns=1) for i in range(3000)]
    message = raw("/tf_static", "tf2_msgs/msg/TFMessage", tf_message(links), 1)
    transforms = read_transforms(MemoryRecording([message]))
    with at_most(30), pytest.raises(FrameError, match="more than 1000 transforms one after another"):
        transforms.lookup("f3000", "f0")


# --- memory does not grow with a recording, and a sound file that is read with too little of it is not called damaged


def blobs(n: int, encoding: Literal["ros1", "cdr"]) -> list[RawMessage]:
    message = raw("/cloud", "sensor_msgs/msg/PointCloud2", {"data": bytes(200_000)}, 0, encoding=encoding)
    return [message._replace(log_time_ns=i) for i in range(n)]


@pytest.mark.parametrize("kind", ["bag-none", "bag-lz4", "sqlite", "mcap-none", "mcap-zstd", "loose"])
def test_memory_does_not_grow_with_the_recording(tmp_path: Path, kind: str) -> None:
    """8 MB and 40 MB of messages: neither is ever in memory as a whole."""
    peaks = []
    for n in (40, 200):
        messages = blobs(n, "ros1" if kind.startswith("bag") else "cdr")
        path = write_recording(tmp_path / f"{kind}{n}", kind, messages)
        tracemalloc.start()
        with open_recording([path]) as recording:
            assert sum(len(m.data) for m in recording.messages()) > n * 200_000
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert max(peaks) < 6 * MIB, peaks
    assert peaks[1] < peaks[0] + MIB / 4, peaks


@pytest.mark.parametrize("recovery", ["none", "as_needed", "full_scan"])
@pytest.mark.parametrize(
    ("kind", "place"),
    [
        ("mcap-zstd", "lidcam.readers.files.mcap.records.zstandard.decompress"),
        ("bag-lz4", "lidcam.readers.files.rosbag1.rosbag1_file.unpack"),
        ("sqlite", "lidcam.readers.files.sqlite_file.decompressed"),
    ],
)
def test_short_memory_is_no_damage_of_a_container(
    tmp_path: Path, kind: str, place: str, recovery: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_recording(tmp_path / "a", kind, blobs(3, "ros1" if kind == "bag-lz4" else "cdr"))
    monkeypatch.setattr(place, Mock(side_effect=MemoryError))
    with (
        pytest.raises(ShortMemoryError, match="not enough memory to read "),
        open_recording([path], ReadOptions(recovery)) as recording,
    ):
        list(recording.messages())


def test_short_memory_is_no_damage_of_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    (message,) = blobs(1, "cdr")
    monkeypatch.setattr("rosbags.typesys.store.Typestore.deserialize_cdr", Mock(side_effect=MemoryError))
    with pytest.raises(MemoryError):
        deserialize(message)
