"""What the index of a ROS 1 bag says: believed where its counts agree, else the bag is scanned."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
from sound_recordings import read_all, sound_recording, write_files

from pipeline.core.errors import RecordingError
from pipeline.core.settings.recording import LimitsConfig
from readers.files.rosbag1.index import contents_of_index
from readers.files.rosbag1.records import contents_of_chunk
from readers.open import open_recording
from readers.recording import ReadOptions

KINDS = ["rosbag1-none", "rosbag1-bz2", "rosbag1-lz4"]


def behind(name: bytes, extra: int = 0) -> Callable[[bytes], int]:
    """A byte behind the first occurrence of a name."""
    return lambda content: content.index(name) + len(name) + extra


def at_the_end(name: bytes, extra: int = 0) -> Callable[[bytes], int]:
    """A byte behind the first occurrence of a name in the index at the end of the file."""
    return lambda content: content.index(name, content.rindex(b"op=\x04")) + len(name) + extra


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("place", "mask", "told"),
    [
        (behind(b"chunk_count="), 1, "its header says 3 connections and"),
        (behind(b"chunk_count=", 3), 0x80, "its header says 3 connections and"),
        (behind(b"conn_count="), 2, "its header says 1 connections and"),
        (behind(b"index_pos="), 1, "its index cannot be used"),
        (behind(b"index_pos=", 7), 1, "its index cannot be used"),
        (at_the_end(b"chunk_pos="), 1, "its index cannot be used"),
        (lambda content: len(content) - 4, 1, "messages in this chunk, found"),
    ],
)
def test_a_changed_bit_that_counts_or_positions_show_costs_no_message(
    tmp_path: Path, kind: str, place: Callable[[bytes], int], mask: int, told: str
) -> None:
    sound = sound_recording(kind)
    content = bytearray(sound.files["rec.bag"])
    content[place(bytes(content))] ^= mask
    messages, losses = read_all(write_files(tmp_path, sound, {"rec.bag": bytes(content)}), "as_needed")
    assert messages == sound.messages
    assert sum(loss.messages or 0 for loss in losses) <= 1  # a count that is too large by one
    assert told in "; ".join(loss.reason for loss in losses)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        (b"compression=", b"non3", "unknown compression"),
        (b"op=\x07", b"\x02", "expected a record of the index"),
    ],
)
def test_what_contradicts_itself_is_no_index(name: bytes, value: bytes, said: str) -> None:
    content = bytearray(sound_recording("rosbag1-none").files["rec.bag"])
    at = content.index(name) + len(name) if name.endswith(b"=") else content.rindex(name) + len(name) - 1
    content[at : at + len(value)] = value
    with pytest.raises(ValueError, match=said):
        contents_of_index(BytesIO(bytes(content)))


def test_chunks_that_overlap_too_far_are_refused(tmp_path: Path) -> None:
    sound = sound_recording("rosbag1-lz4")
    path = write_files(tmp_path, sound, sound.files)
    options = ReadOptions(limits=LimitsConfig(max_positions_waiting=3))
    with (
        open_recording([path], options) as recording,
        pytest.raises(RecordingError, match=r"more than 3 .*max_positions_waiting"),
    ):
        list(recording.messages())


@pytest.mark.parametrize("kind", KINDS)
def test_a_chunk_that_is_damaged_is_lost_alone(tmp_path: Path, kind: str) -> None:
    sound = sound_recording(kind)
    content = bytearray(sound.files["rec.bag"])
    at = content.index(b"op=\x05", content.index(b"op=\x05") + 1) + 60
    content[at : at + 300] = bytes(300)
    messages, losses = read_all(write_files(tmp_path, sound, {"rec.bag": bytes(content)}), "as_needed")
    assert 0 < len(sound.messages) - len(messages) <= 12
    assert sum(loss.messages or 0 for loss in losses) == len(sound.messages) - len(messages)


def test_many_false_records_are_bounded() -> None:
    """Empty messages without end."""
    message = b"\x26\0\0\0\x04\0\0\0op=\x02\x09\0\0\0conn=\0\0\0\0\x0d\0\0\0time=" + bytes(12)
    with pytest.raises(ValueError, match="max_messages_per_chunk"):
        contents_of_chunk(message * 30, LimitsConfig(max_messages_per_chunk=20))
