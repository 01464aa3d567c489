"""What a changed bit in the index of a ROS 1 bag, or in the records that it lists, does to what is read."""

import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
from sound_recordings import SoundRecording, read_all, sound_recording, write_files

from pipeline.core.errors import RecordingError
from pipeline.core.settings.recording import LimitsConfig
from readers.files.rosbag1.index import contents_of_index
from readers.open import open_recording
from readers.recording import ReadOptions

KINDS = ["rosbag1-none", "rosbag1-bz2", "rosbag1-lz4"]


def behind(name: bytes, extra: int = 0) -> Callable[[bytes], int]:
    """A byte behind the first occurrence of a name."""
    return lambda content: content.index(name) + len(name) + extra


def at_the_end(name: bytes, extra: int = 0) -> Callable[[bytes], int]:
    """A byte behind the first occurrence of a name in the index at the end of the file."""
    return lambda content: content.index(name, content.rindex(b"op=\x04")) + len(name) + extra


def second_message(name: bytes) -> Callable[[bytes], int]:
    """A byte behind a name in the header of the second message, a byte of its length for no name."""

    def place(content: bytes) -> int:
        header = content.index(b"op=\x02", content.index(b"op=\x02") + 1)
        return content.index(name, header) + len(name) if name else header + 34

    return place


def altered(tmp_path: Path, sound: SoundRecording, place: int, mask: int) -> Path:
    content = bytearray(sound.files["rec.bag"])
    content[place] ^= mask
    return write_files(tmp_path, sound, {"rec.bag": bytes(content)})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("place", "mask", "told"),
    [
        (behind(b"chunk_count="), 1, "its header says 3 connections and"),
        (behind(b"chunk_count=", 3), 0x80, "its header says 3 connections and"),
        (behind(b"conn_count="), 2, "its header says 1 connections and"),
        (behind(b"index_pos="), 1, "its index cannot be used"),
        (behind(b"index_pos=", 7), 1, "its index cannot be used"),
        (at_the_end(b"topic=/"), 1, "connection 0 (/odom) is not the same"),
        (at_the_end(b"type=nav_msgs/"), 1, "connection 0 (/odom) is not the same"),
        (at_the_end(b"md5sum="), 1, "connection 0 (/odom) is not the same"),
        (at_the_end(b"message_definition=", 40), 1, "connection 0 (/odom) is not the same"),
        (at_the_end(b"chunk_pos="), 1, "its index cannot be used"),
        (at_the_end(b"start_time=", 4), 1, "names times that the chunk does not cover"),
        (lambda content: len(content) - 4, 1, "messages according to"),
        (behind(b"op=\x04", 16), 0x40, "the bytes were overwritten"),
        (behind(b"op=\x04", 8), 4, "has another version"),
        (behind(b"op=\x04", 47), 1, "does not agree with the messages in it"),
        (behind(b"op=\x04", 51), 1, "does not agree with the messages in it"),
    ],
)
def test_a_changed_bit_in_the_index_costs_no_message(
    tmp_path: Path, kind: str, place: Callable[[bytes], int], mask: int, told: str
) -> None:
    sound = sound_recording(kind)
    messages, losses = read_all(altered(tmp_path, sound, place(sound.files["rec.bag"]), mask), "as_needed")
    assert messages == sound.messages
    assert sum(loss.messages or 0 for loss in losses) == 0
    assert told in "; ".join(loss.reason for loss in losses)


@pytest.mark.parametrize(
    ("place", "mask", "lost", "told"),
    [
        (second_message(b"conn="), 0x40, 0, "does not agree with the messages in it"),
        (second_message(b"conn="), 1, 0, "does not agree with the messages in it"),
        (second_message(b"time="), 1, 0, "does not agree with the messages in it"),
        (second_message(b""), 4, 1, "the chunk has none"),
    ],
)
def test_a_changed_bit_in_a_message_is_told(
    tmp_path: Path, place: Callable[[bytes], int], mask: int, lost: int, told: str
) -> None:
    sound = sound_recording("rosbag1-none")
    path = altered(tmp_path, sound, place(sound.files["rec.bag"]), mask)
    messages, losses = read_all(path, "as_needed")
    assert len(messages) == len(sound.messages) - lost
    assert {message.data for message in messages} <= {message.data for message in sound.messages}
    assert sum(loss.messages or 0 for loss in losses) == lost
    assert told in "; ".join(loss.reason for loss in losses)
    with pytest.raises(RecordingError, match="damaged"):
        read_all(path, "none")
    assert read_all(path, "full_scan")[1]


def test_chunks_that_overlap_too_far_are_refused(tmp_path: Path) -> None:
    sound = sound_recording("rosbag1-lz4")
    path = write_files(tmp_path, sound, sound.files)
    options = ReadOptions(limits=LimitsConfig(max_positions_waiting=6))
    with (
        open_recording([path], options) as recording,
        pytest.raises(RecordingError, match=r"more than 3 .*max_positions_waiting"),
    ):
        list(recording.messages())


@pytest.mark.parametrize(
    ("name", "extra", "value", "said"),
    [
        (b"topic=/image", -8, b"\0", "lists connection 0 twice"),
        (b"compression=", 3, b"f", "unknown compression"),
        (b"size=", 0, b"\1", "gives two sizes"),
        (b"ver=", 0, b"\2", "another version"),
        (b"\n\0\0\0count=\x03\0\0\0", 4 + 12 + 8, b"\xe6\5", "names a message twice"),
    ],
)
def test_what_contradicts_itself_is_no_index(name: bytes, extra: int, value: bytes, said: str) -> None:
    content = bytearray(sound_recording("rosbag1-none").files["rec.bag"])
    at = content.rindex(name, 0, content.rindex(name)) if name.startswith(b"topic") else content.index(name)
    place = at + len(name) + extra if extra >= 0 else at + extra
    content[place : place + len(value)] = value
    with pytest.raises(ValueError, match=said):
        contents_of_index(BytesIO(bytes(content)))


class LargestRead(BytesIO):
    """A file that remembers the most bytes that were asked for at once."""

    largest = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.largest = max(self.largest, len(data))
        return data


def test_an_index_that_lost_a_chunk_does_not_read_that_chunk_into_memory() -> None:
    content = sound_recording("rosbag1-none").files["rec.bag"]
    index_at = content.index(b"index_pos=") + len(b"index_pos=")
    (index_position,) = struct.unpack_from("<Q", content, index_at)
    foreign = bytes(5 << 20)
    changed = bytearray(content[:index_position] + foreign + content[index_position:])
    struct.pack_into("<Q", changed, index_at, index_position + len(foreign))
    stream = LargestRead(bytes(changed))
    with pytest.raises(ValueError, match="bytes behind it"):
        contents_of_index(stream)
    assert stream.largest < 1 << 20


@pytest.mark.parametrize("kind", KINDS)
def test_a_chunk_that_is_damaged_is_lost_alone(tmp_path: Path, kind: str) -> None:
    sound = sound_recording(kind)
    content = bytearray(sound.files["rec.bag"])
    at = content.index(b"op=\x05", content.index(b"op=\x05") + 1) + 60
    content[at : at + 300] = bytes(300)
    messages, losses = read_all(write_files(tmp_path, sound, {"rec.bag": bytes(content)}), "as_needed")
    assert 0 < len(sound.messages) - len(messages) <= 12
    assert sum(loss.messages or 0 for loss in losses) == len(sound.messages) - len(messages)
