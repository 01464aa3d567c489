"""Damaged files of every container: genuine ones against what rosbag's reindex recovers, and damage of our own."""

import hashlib
import json
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from random import Random
from typing import Any

import pytest
from damage_judge import judge_altered
from helpers import shared
from hypothesis import given, settings
from hypothesis import strategies as st
from sound_recordings import KINDS, read_all, sound_recording, write_files

from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.recording import Loss

Content = tuple[str, int, str]
"""Topic, log time, MD5 of the bytes."""


# --- genuine bags

REINDEXED = {"killed_none": 49, "killed_lz4": 49, "cut_lz4_60pct": 45, "cut_none_60pct": 42, "cut_none_lastbyte": 80}


def genuine(name: str) -> dict[str, Any]:
    entry: dict[str, Any] = json.loads(shared("oracles/genuine_bags/manifest.json").read_text())[name]
    return entry


def listed(entry: dict[str, Any]) -> set[Content]:
    return {(topic, time, md5) for topic, _, _, time, _, md5 in entry["list"]}


def recovered(name: str, *, thorough: bool = False) -> tuple[list[Content], tuple[Loss, ...]]:
    path = shared(f"oracles/genuine_bags/{name}.bag")
    messages, losses = read_all(path, "full_scan" if thorough else "as_needed")
    return [(m.name[0], m.log_time_ns, hashlib.md5(m.data).hexdigest()) for m in messages], losses


@pytest.mark.parametrize("thorough", [False, True])
@pytest.mark.parametrize("name", REINDEXED)
def test_at_least_what_rosbag_reindex_recovers(name: str, thorough: bool) -> None:
    reindexed = genuine(f"{name}.bag")["after_genuine_reindex"]
    got, losses = recovered(name, thorough=thorough)
    assert len(listed(reindexed)) == REINDEXED[name]
    assert listed(reindexed) <= set(got) <= listed(genuine("seed_lz4_chunky.bag"))
    assert losses


@pytest.mark.parametrize("thorough", [False, True])
def test_a_chunk_that_fails_its_checksum_is_named_and_the_others_are_read(thorough: bool) -> None:
    """The genuine library stops at it."""
    got, (loss,) = recovered("corrupt_lz4_middle", thorough=thorough)
    assert (len(got), loss.messages, loss.position, loss.size) == (76, 4, 291499, 38914)
    assert "Checksum" in loss.reason
    assert set(got) < listed(genuine("seed_lz4_chunky.bag"))


def test_an_index_that_is_cut_off_costs_no_message() -> None:
    _, (loss,) = recovered("cut_none_lastbyte")
    assert (loss.messages, loss.size) == (0, 115)
    assert "index" in loss.reason


@pytest.mark.parametrize("name", ["cut_empty", "cut_header", "cut_magic_only"])
def test_genuine_bags_of_which_nothing_is_left(name: str) -> None:
    with pytest.raises(RecordingError, match=rf"{name}.bag: .*(copy it again|record)") as caught:
        recovered(name)
    assert "\n" not in str(caught.value)


# --- damage of our own


@pytest.mark.parametrize("kind", KINDS)
def test_sound_files_have_no_losses(tmp_path: Path, kind: str) -> None:
    sound = sound_recording(kind)
    path = write_files(tmp_path, sound, sound.files)
    for recovery in ("as_needed", "full_scan"):
        messages, losses = read_all(path, recovery)
        assert messages == sound.messages
        assert {loss.reason for loss in losses} == sound.told


@settings(max_examples=100)
@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 10**9))
def test_nothing_is_lost_or_altered_in_silence(kind: str, seed: int) -> None:
    verdict, _ = judge_altered(kind, Random(seed))
    assert not verdict.is_fault, verdict.detail


@given(kind=st.sampled_from(["rosbag1-none", "mcap-none", "mcap-no-chunks", "pcap"]), share=st.floats(0, 1))
def test_what_comes_before_a_cut_is_read(tmp_path_factory: pytest.TempPathFactory, kind: str, share: float) -> None:
    sound = sound_recording(kind)
    ((name, whole),) = sound.files.items()
    size = int(share * (len(whole) - 1))
    path = write_files(tmp_path_factory.mktemp("cut"), sound, {name: whole[:size]})
    own = [message.data[12:] if kind == "pcap" else message.data for message in sound.messages]  # without our stamp
    before = sum(whole.find(data) + len(data) <= size for data in own if len(data) > 100)
    try:
        messages, losses = read_all(path, "as_needed")
    except RecordingError:
        assert before == 0
        return
    assert not any("overwritten" in loss.reason for loss in losses)
    assert before <= len(messages)
    assert {*messages} <= {*sound.messages}


def behind(name: bytes, extra: int = 0) -> Callable[[bytes], int]:
    """A byte behind the first occurrence of a name."""
    return lambda content: content.index(name) + len(name) + extra


def at_the_end(name: bytes) -> Callable[[bytes], int]:
    """A byte behind a name in the index at the end of a bag."""
    return lambda content: content.index(name, content.rindex(b"op=\x04")) + len(name)


def start_of_second_chunk(content: bytes) -> int:
    first = at_the_end(b"start_time=")(content)
    return content.index(b"start_time=", first) + len(b"start_time=")


def second_chunk(content: bytes) -> int:
    return content.index(b"op=\x05", content.index(b"op=\x05") + 1) + 60


def head_of(kind: int, number: int) -> Callable[[bytes], int]:
    """The opcode of a message of an MCAP file without chunks, or the one of a record of its kind."""
    data = sound_recording("mcap-no-chunks").messages[number].data
    return lambda content: content.find(data) - 22 - 9 if kind == 5 else content.index(b"/image") - 8 - 9


BAGS = ["rosbag1-none", "rosbag1-bz2", "rosbag1-lz4"]
CHECKED = ["mcap-none", "mcap-lz4", "mcap-zstd"]


@pytest.mark.parametrize(
    ("kinds", "place", "written", "max_lost", "told"),
    [
        (BAGS, behind(b"chunk_count="), b"\x7f", 0, "its header says 3 connections and"),
        (BAGS, behind(b"conn_count="), b"\x01", 0, "its header says 1 connections and"),
        (BAGS, behind(b"index_pos="), b"\x01", 0, "its index cannot be used"),
        (BAGS, behind(b"index_pos=", 7), b"\x01", 0, "its index cannot be used"),
        (BAGS, at_the_end(b"chunk_pos="), b"\x01", 0, "its index cannot be used"),
        (BAGS, behind(b"compression="), b"x", 0, "unknown compression"),
        (BAGS, lambda content: len(content) - 4, b"\x7f", 127, "messages in this chunk, found"),
        (BAGS, second_chunk, bytes(300), 12, ""),
        (BAGS, start_of_second_chunk, b"\x05", 12, "found too late to be read"),
        (["rosbag1-none"], behind(b"op=\x02\x09\0\0\0conn="), b"\x40", 1, "channels that the file does not name"),
        (CHECKED, lambda _: 1500, b"crc", 12, "a chunk that cannot be read"),
        (CHECKED, lambda content: len(content) - 20, b"\xff", 0, "its summary cannot be used"),
        (CHECKED, lambda content: len(content) - 40, b"\xff", 0, "the checksum of its summary is wrong"),
        (["mcap-no-chunks"], head_of(5, 20), b"\x7f", 1, "no record begins here"),
        (["mcap-no-chunks-no-crc"], head_of(4, 0), b"\x7f", 6, ""),
    ],
)
def test_what_damage_costs(
    tmp_path: Path, kinds: list[str], place: Callable[[bytes], int], written: bytes, max_lost: int, told: str
) -> None:
    for kind in kinds:
        sound = sound_recording(kind)
        ((name, whole),) = sound.files.items()
        at = place(whole)
        content = whole[:at] + written + whole[at + len(written) :]
        messages, losses = read_all(write_files(tmp_path, sound, {name: content}), "as_needed")
        reasons = "; ".join(loss.reason for loss in losses)
        lost = len(sound.messages) - len(messages)
        assert {*messages} <= {*sound.messages}, kind
        assert lost <= max_lost, reasons
        assert lost <= sum(loss.messages or 0 for loss in losses) <= max_lost, reasons
        assert told in reasons, kind


# --- SQLite

SQLITE = sound_recording("sqlite")


def page_of(path: Path, name: str) -> tuple[int, int]:
    """The size of the pages, and the first byte of the root page of a table or an index."""
    with closing(sqlite3.connect(path)) as database:
        (size,) = next(database.execute("PRAGMA page_size"))
        (root,) = next(database.execute(f"SELECT rootpage FROM sqlite_master WHERE name = '{name}'"))
    return size, (root - 1) * size


def altered(tmp_path: Path, change: Callable[[Path, bytearray], None]) -> Any:
    path = write_files(tmp_path, SQLITE, SQLITE.files)
    content = bytearray(path.read_bytes())
    change(path, content)
    path.write_bytes(content)
    return read_all(path, "as_needed")


def test_a_database_without_its_last_pages(tmp_path: Path) -> None:
    def cut(_: Path, content: bytearray) -> None:
        del content[len(content) * 3 // 4 :]

    messages, losses = altered(tmp_path, cut)
    assert {*messages} < {*SQLITE.messages}
    assert len(messages) >= len(SQLITE.messages) * 0.4
    assert any("it was cut off" in loss.reason for loss in losses)


def test_messages_behind_pages_that_cannot_be_read(tmp_path: Path) -> None:
    def overwrite(path: Path, content: bytearray) -> None:
        size, at = page_of(path, "messages")
        (place,) = struct.unpack_from(">H", content, at + 12 + 2)  # of the second child
        leaf = int.from_bytes(content[at + place : at + place + 4], "big")
        content[(leaf - 1) * size : leaf * size] = bytes(size)

    messages, (loss,) = altered(tmp_path, overwrite)
    lost = [row for row, message in enumerate(SQLITE.messages) if message not in messages]
    assert 1 < len(lost) < 20
    assert lost == [*range(lost[0], lost[-1] + 1)]
    assert 0 < lost[0] < lost[-1] < len(SQLITE.messages) - 1
    assert loss.messages == len(lost)


def test_a_damaged_index_of_sqlite_costs_nothing(tmp_path: Path) -> None:
    def overwrite(path: Path, content: bytearray) -> None:
        _, at = page_of(path, "timestamp_idx")
        content[at : at + 100] = b"\xff" * 100

    messages, (loss,) = altered(tmp_path, overwrite)
    assert (messages, loss.messages) == (SQLITE.messages, 0)
    assert "SQLite cannot read all of it (database disk image is malformed); 45 messages were found" in loss.reason
