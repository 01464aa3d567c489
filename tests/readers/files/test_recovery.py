"""What is read of damaged files: genuine ones against what rosbag's reindex recovers, and damage of our own."""

import hashlib
import json
import sqlite3
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import zstandard
from builders import image, odometry, raw, write_mcap, write_rosbag1, write_rosbag2
from helpers import shared
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.core.errors import RecordingError
from pipeline.core.messages import RawMessage
from readers.open import open_recording
from readers.recording import Loss, ReadOptions

T0 = 1_700_000_000 * 10**9
ODOMETRY, IMAGE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Image"

Content = tuple[str, int, str]
"""Topic, log time, MD5 of the bytes."""

KINDS = ["bag-none", "bag-bz2", "bag-lz4", "mcap-none", "mcap-lz4", "mcap-zstd", "loose", "sqlite"]
CHECKED = ["bag-bz2", "mcap-none", "mcap-lz4", "mcap-zstd"]
"""Kinds with a checksum over every message. rosbags writes lz4 frames without one, the genuine library with one."""


def drive(encoding: Literal["ros1", "cdr"], count: int = 40) -> list[RawMessage]:
    """States at 100 Hz, with every fourth an image whose bytes no compressor makes smaller."""
    noise = np.random.default_rng(5)
    messages = []
    for i in range(count):
        stamp = T0 + i * 10**7
        messages.append(raw("/odom", ODOMETRY, odometry(stamp_ns=stamp, position=(i, 0, 0)), stamp, stamp, encoding))
        if i % 4 == 0:
            image_message = image(noise.integers(0, 255, (20, 30, 3), np.uint8), stamp_ns=stamp)
            messages.append(raw("/image", IMAGE, image_message, stamp, stamp + 1, encoding))
    return messages


def write(folder: Path, kind: str, count: int = 40) -> tuple[Path, list[RawMessage]]:
    messages = drive("ros1" if kind.startswith("bag") else "cdr", count)
    form, _, how = kind.partition("-")
    compression: Any = how
    path = folder / f"rec.{'bag' if form == 'bag' else 'mcap'}"
    if form == "bag":
        write_rosbag1(path, messages, compression, chunk_bytes=5000)
    elif form == "mcap":
        write_mcap(path, messages, compression, chunk_bytes=5000)
    elif form == "loose":
        write_mcap(path, messages, use_chunking=False)
    else:
        write_rosbag2(folder / "rec", messages)
        path = folder / "rec" / "rec.db3"
    return path, messages


def content(message: RawMessage) -> Content:
    return message.topic, message.log_time_ns, hashlib.md5(message.data).hexdigest()


def recovered(path: Path, *, thorough: bool = False) -> tuple[list[Content], tuple[Loss, ...]]:
    with open_recording([path], ReadOptions("full_scan" if thorough else "as_needed")) as recording:
        messages = list(recording.messages())
        keys = [(m.log_time_ns, m.order) for m in messages]
        assert keys == sorted(keys)
        again = [content(m) for m in recording.messages()]
        assert again == [content(m) for m in messages]
        return again, recording.losses


# --- genuine bags

REINDEXED = {"killed_none": 49, "killed_lz4": 49, "cut_lz4_60pct": 45, "cut_none_60pct": 42, "cut_none_lastbyte": 80}


def genuine(name: str) -> dict[str, Any]:
    entry: dict[str, Any] = json.loads(shared("oracles/genuine_bags/manifest.json").read_text())[name]
    return entry


def listed(entry: dict[str, Any]) -> set[Content]:
    return {(topic, time, md5) for topic, _, _, time, _, md5 in entry["list"]}


@pytest.mark.parametrize("thorough", [False, True])
@pytest.mark.parametrize("name", REINDEXED)
def test_at_least_what_rosbag_reindex_recovers(name: str, thorough: bool) -> None:
    reindexed = genuine(f"{name}.bag")["after_genuine_reindex"]
    got, losses = recovered(shared(f"oracles/genuine_bags/{name}.bag"), thorough=thorough)
    assert len(listed(reindexed)) == REINDEXED[name]
    assert listed(reindexed) <= set(got) <= listed(genuine("seed_lz4_chunky.bag"))
    assert losses


@pytest.mark.parametrize("thorough", [False, True])
def test_a_chunk_that_fails_its_checksum_is_named_and_the_others_are_read(thorough: bool) -> None:
    """The genuine library stops at it."""
    got, (loss,) = recovered(shared("oracles/genuine_bags/corrupt_lz4_middle.bag"), thorough=thorough)
    assert (len(got), loss.messages, loss.position, loss.size) == (76, 4, 291499, 38914)
    assert "Checksum" in loss.reason
    assert set(got) < listed(genuine("seed_lz4_chunky.bag"))


def test_an_index_that_is_cut_off_costs_no_message() -> None:
    _, (loss,) = recovered(shared("oracles/genuine_bags/cut_none_lastbyte.bag"))
    assert (loss.messages, loss.size) == (0, 115)
    assert "index" in loss.reason


@pytest.mark.parametrize("name", ["cut_empty", "cut_header", "cut_magic_only"])
def test_genuine_bags_of_which_nothing_is_left(name: str) -> None:
    path = shared(f"oracles/genuine_bags/{name}.bag")
    with pytest.raises(RecordingError, match=rf"{name}.bag: .*(copy it again|record)") as caught:
        open_recording([path])
    assert "\n" not in str(caught.value)


@settings(max_examples=40, deadline=None)
@given(place=st.integers(4117, 887_000), bit=st.integers(0, 7))
def test_a_flipped_bit_in_a_genuine_lz4_bag(tmp_path_factory: pytest.TempPathFactory, place: int, bit: int) -> None:
    damaged = bytearray(shared("oracles/genuine_bags/seed_lz4_chunky.bag").read_bytes())
    damaged[place] ^= 1 << bit
    path = tmp_path_factory.mktemp("flip") / "flip.bag"
    path.write_bytes(damaged)
    whole = {(time, md5) for _, time, md5 in listed(genuine("seed_lz4_chunky.bag"))}
    got, losses = recovered(path)
    assert {(time, md5) for _, time, md5 in got} <= whole
    assert len(got) >= 80 - 7  # one chunk at most
    assert len(got) == 80 or losses


# --- damage of our own


class Recordings(dict[str, tuple[Path, list[RawMessage]]]):
    """A sound file of each kind, and its messages."""

    def __repr__(self) -> str:
        return "the recordings"  # hypothesis prints arguments


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    return Recordings({kind: write(tmp_path_factory.mktemp("whole"), kind) for kind in KINDS})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("thorough", [False, True])
def test_sound_files_have_no_losses(recordings: Recordings, kind: str, thorough: bool) -> None:
    path, messages = recordings[kind]
    assert recovered(path, thorough=thorough) == ([content(m) for m in messages], ())


@settings(max_examples=120, deadline=None)
@given(kind=st.sampled_from(KINDS), share=st.floats(0, 1, exclude_max=True))
def test_what_comes_before_a_cut_is_read(
    tmp_path_factory: pytest.TempPathFactory,
    recordings: Recordings,
    kind: str,
    share: float,
) -> None:
    path, messages = recordings[kind]
    whole = path.read_bytes()
    size = int(share * len(whole))
    cut = tmp_path_factory.mktemp("cut") / path.name
    cut.write_bytes(whole[:size])
    before = 0  # messages whose bytes the cut file still holds, as far as their place can be told
    if kind in {"bag-none", "loose", "mcap-none"}:
        before = sum(whole.find(bytes(m.data)) + len(m.data) <= size for m in messages)
    try:
        got, losses = recovered(cut)
    except RecordingError:
        assert before == 0
        return
    assert set(got) <= {content(m) for m in messages}
    assert len(got) >= before
    assert losses


@settings(max_examples=150, deadline=None)
@given(kind=st.sampled_from(KINDS), share=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@example(kind="sqlite", share=0.889593639654536, bit=0)
@example(kind="mcap-lz4", share=0.6098125858572621, bit=1)
def test_a_flipped_bit_never_alters_a_message_that_has_a_checksum(
    tmp_path_factory: pytest.TempPathFactory,
    recordings: Recordings,
    kind: str,
    share: float,
    bit: int,
) -> None:
    path, messages = recordings[kind]
    damaged = bytearray(path.read_bytes())
    damaged[int(share * len(damaged))] ^= 1 << bit
    flipped = tmp_path_factory.mktemp("flip") / path.name
    flipped.write_bytes(damaged)
    for thorough in (False, True):
        with suppress(RecordingError):  # the first bytes, which say what a file is
            got, losses = recovered(flipped, thorough=thorough)
            if kind in CHECKED:  # not the topic: names are outside of the chunks, too
                assert {key[1:] for key in got} <= {content(m)[1:] for m in messages} or (thorough and losses)
                assert len(got) == len(messages) or losses


@settings(max_examples=60, deadline=None)
@given(kind=st.sampled_from(KINDS), share=st.floats(0, 1, exclude_max=True), size=st.integers(1, 6000))
def test_zeros_in_the_middle_leave_both_sides(
    tmp_path_factory: pytest.TempPathFactory,
    recordings: Recordings,
    kind: str,
    share: float,
    size: int,
) -> None:
    path, messages = recordings[kind]
    damaged = bytearray(path.read_bytes())
    start = 5000 + int(share * (len(damaged) - 5000 - size))
    damaged[start : start + size] = bytes(size)
    holed = tmp_path_factory.mktemp("hole") / path.name
    holed.write_bytes(damaged)
    try:
        got, losses = recovered(holed)
    except RecordingError:
        assert kind == "sqlite"  # its tables of topics
        return
    assert len(got) <= len(messages)
    if kind in CHECKED:
        assert {key[1:] for key in got} <= {content(m)[1:] for m in messages}
        assert len(got) == len(messages) or losses
        assert len(messages) - len(got) <= 26  # three chunks of 5000 bytes at most


def test_a_record_whose_kind_was_overwritten_costs_that_record(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "loose")
    damaged = bytearray(path.read_bytes())
    place = damaged.find(bytes(messages[20].data)) - 22 - 9  # opcode and length, then the message's own head
    assert damaged[place] == 5
    damaged[place] = 0x7F
    path.write_bytes(damaged)
    got, (loss,) = recovered(path)
    assert [key for key in map(content, messages) if key not in got] == [content(messages[20])]
    assert (loss.position, loss.messages) == (place, 1)


def test_a_wrong_index_does_not_hide_messages(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "bag-none")
    damaged = bytearray(path.read_bytes())
    seconds = (T0 // 10**9).to_bytes(4, "little")
    at = damaged.index(seconds + bytes(4), damaged.index(b"op=\x04"))  # the first entry of the first index
    damaged[at + 8] ^= 0x10  # the offset of a message
    path.write_bytes(damaged)
    got, losses = recovered(path)
    assert (got, losses) == ([content(m) for m in messages], ())  # where a message is, its chunk says
    assert recovered(path, thorough=True) == ([content(m) for m in messages], ())


def test_topics_that_only_a_damaged_chunk_names_are_read_and_told(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "mcap-none")
    damaged = bytearray(path.read_bytes())[:30_000]  # without the summary, which repeats the names
    damaged[damaged.index(b"base_link")] ^= 1
    path.write_bytes(damaged)
    got, losses = recovered(path)
    assert set(got) < {content(m) for m in messages}
    assert len(got) > 10
    assert [("crc" in loss.reason, "/odom" in loss.reason) for loss in losses[:2]] == [(True, False), (False, True)]


def test_messages_whose_topic_is_lost_are_counted(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "loose")
    damaged = bytearray(path.read_bytes())[:30_000]
    place = damaged.index(b"/image") - 8 - 9  # ids and the name's length, then opcode and length
    assert damaged[place] == 4
    damaged[place] = 0x7F
    path.write_bytes(damaged)
    got, losses = recovered(path)
    assert {topic for topic, _, _ in got} == {"/odom"}
    assert len([loss for loss in losses if "their topic and type are unknown" in loss.reason and loss.messages]) == 1
    assert set(got) < {content(m) for m in messages}


# --- SQLite


def test_a_database_without_its_last_pages(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "sqlite", 400)
    size = path.stat().st_size
    with path.open("r+b") as stream:
        stream.truncate(size * 3 // 4)
    got, losses = recovered(path)
    assert set(got) < {content(m) for m in messages}
    assert len(got) > len(messages) * 0.6
    assert any("it was cut off" in loss.reason for loss in losses)


def test_a_damaged_index_of_sqlite_costs_nothing(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "sqlite", 400)
    with closing(sqlite3.connect(path)) as database:
        (size,) = next(database.execute("PRAGMA page_size"))
        (root,) = next(database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'timestamp_idx'"))
    with path.open("r+b") as stream:
        stream.seek((root - 1) * size)
        stream.write(b"\xff" * 100)
    got, (loss,) = recovered(path)
    assert (got, loss.messages) == ([content(m) for m in messages], 0)
    assert "the rows were found by reading every page" in loss.reason


def test_rows_on_overwritten_pages_are_passed_over(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "sqlite", 400)
    with path.open("r+b") as stream:
        stream.seek(path.stat().st_size // 8192 * 4096)
        stream.write(bytes(4096))
    got, losses = recovered(path)
    assert set(got) < {content(m) for m in messages}
    assert len(messages) - 30 < len(got)
    assert sum(loss.messages or 0 for loss in losses) == len(messages) - len(got)


def test_a_message_without_bytes_is_passed_over(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "sqlite")
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE messages SET data = 'text' WHERE id = 3")
        database.execute("UPDATE messages SET topic_id = 99 WHERE id = 4")
    got, losses = recovered(path)
    assert len(got) == len(messages) - 2
    assert sorted(loss.reason for loss in losses) == [
        "message 3: message 3 has no bytes",
        "messages of a topic that the file does not list",
    ]


@pytest.mark.parametrize("journal_mode", ["WAL", "DELETE"])
def test_what_the_recorder_left_in_its_journal_is_brought_in(tmp_path: Path, journal_mode: str) -> None:
    path, messages = write(tmp_path, "sqlite")
    killed = tmp_path / "killed"
    killed.mkdir()
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(f"PRAGMA journal_mode={journal_mode}")
        database.execute("PRAGMA cache_size=5")  # so that changes are written out before they are committed
        database.execute("BEGIN")
        database.execute("INSERT INTO messages SELECT id + 1000, topic_id, timestamp + 1000000000, data FROM messages")
        if journal_mode == "WAL":
            database.execute("COMMIT")
        for file in path.parent.glob("rec.db3*"):
            (killed / file.name).write_bytes(file.read_bytes())
    files = {file.name: file.read_bytes() for file in killed.iterdir()}
    assert len(files) >= 2
    got, losses = recovered(killed / "rec.db3")
    assert len(got) == len(messages) * (2 if journal_mode == "WAL" else 1)
    assert [loss.messages for loss in losses] == [0]
    assert "the recorder did not close it" in losses[0].reason
    assert {file.name: file.read_bytes() for file in killed.iterdir()} == files


# --- split and compressed files


def test_a_split_recording_whose_last_file_is_empty(tmp_path: Path) -> None:
    """As a killed rosbag2 leaves it."""
    path, messages = write(tmp_path, "mcap-zstd")
    empty = tmp_path / "rec_1.mcap"
    empty.write_bytes(b"")
    with open_recording([path, empty]) as recording:
        assert [content(m) for m in recording.messages()] == [content(m) for m in messages]
        (loss,) = recording.losses
        assert (loss.path, loss.size) == (empty, 0)
        assert recording.paths == (path, empty)
    for paths in ([empty], [empty, tmp_path / "rec_2.mcap"]):
        (tmp_path / "rec_2.mcap").write_bytes(b"")
        with pytest.raises(RecordingError, match="an empty file"):
            open_recording(paths)


def test_a_compressed_file_that_is_cut_off(tmp_path: Path) -> None:
    path, messages = write(tmp_path, "mcap-none", 400)
    packed = zstandard.ZstdCompressor().compress(path.read_bytes())
    cut = tmp_path / "rec.mcap.zstd"
    cut.write_bytes(packed[: len(packed) * 3 // 4])
    got, losses = recovered(cut)
    assert set(got) < {content(m) for m in messages}
    assert len(got) > len(messages) // 2
    assert losses
