"""What a changed bit does to an MCAP file whose writer left out checksums, chunks or an index."""

from collections.abc import Callable
from pathlib import Path

import pytest
from builders import odometry, raw, write_mcap
from sound_recordings import SoundRecording, read_all, sound_recording, write_files

from pipeline.core.errors import RecordingError

WITHOUT_CRC = ["mcap-no-crc", "folder-mcap"]
LOOSE = ["mcap-no-chunks", "mcap-no-chunks-no-crc"]


def first(name: bytes, extra: int = 0) -> Callable[[bytes], int]:
    """A byte of the first occurrence of something."""
    return lambda content: content.index(name) + extra


def last(name: bytes, extra: int = 0) -> Callable[[bytes], int]:
    """A byte of the last occurrence of something."""
    return lambda content: content.rindex(name) + extra


def record(opcode: int, number: int, extra: int) -> Callable[[bytes], int]:
    """A byte of the content of one of the records with an opcode; the last one for -1."""

    def place(content: bytes) -> int:
        places, at = [], 8
        while at < len(content) - 8:
            if content[at] == opcode:
                places.append(at + 9)
            at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
        return places[number] + extra

    return place


CHUNK, MESSAGE, MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, FOOTER = 6, 5, 7, 8, 11, 2


def altered(tmp_path: Path, sound: SoundRecording, place: Callable[[bytes], int], mask: int) -> Path:
    content = bytearray(sound.files["rec.mcap"])
    content[place(bytes(content))] ^= mask
    return write_files(tmp_path, sound, {**sound.files, "rec.mcap": bytes(content)})


@pytest.mark.parametrize("kind", WITHOUT_CRC)
@pytest.mark.parametrize(
    ("place", "told"),
    [
        (record(CHUNK_INDEX, -1, 0), "is another one than its summary says"),  # time of the first message
        (record(CHUNK_INDEX, -1, 8), "is another one than its summary says"),
        (record(CHUNK_INDEX, -1, 16), "its summary"),  # position
        (record(CHUNK_INDEX, -1, 24), "is another one than its summary says"),
        (record(CHUNK_INDEX, -1, 36), "other channels in a chunk than the indexes|does not"),
        (record(STATISTICS, 0, 0), "its statistics"),
        (record(STATISTICS, 0, 26), "its statistics name log times"),
        (record(STATISTICS, 0, 34), "its statistics name log times"),
        (record(MESSAGE_INDEX, 0, 0), "its summary counts other messages"),
        (record(MESSAGE_INDEX, 0, 6), "the index behind this chunk does not agree"),
        (record(MESSAGE_INDEX, 0, 14), "the index behind this chunk does not agree"),
        (record(CHUNK, 0, 0), "is another one than its summary says"),
        (last(b"/odom", 1), "is another one here than elsewhere"),
        (last(b"nav_msgs/msg/Odometry", 1), "is another one here than elsewhere"),
    ],
)
def test_a_changed_bit_is_told(tmp_path: Path, kind: str, place: Callable[[bytes], int], told: str) -> None:
    sound = sound_recording(kind)
    messages, losses = read_all(altered(tmp_path, sound, place, 1), "as_needed")
    assert [(m.log_time_ns, m.data) for m in messages] == [(m.log_time_ns, m.data) for m in sound.messages]
    reasons = "; ".join(loss.reason for loss in losses)
    assert any(text in reasons for text in told.split("|")), reasons
    assert not sum(loss.messages or 0 for loss in losses)


@pytest.mark.parametrize("kind", LOOSE)
@pytest.mark.parametrize(
    ("place", "mask", "told"),
    [
        (first(b"/odom", 1), 1, "channel 1 ('/odom') is another one here than elsewhere in the file ('/ndom')"),
        (last(b"nav_msgs/msg/Odometry", 1), 1, "its summary cannot be used|is another one here than elsewhere"),
        (record(MESSAGE, 0, 0), 2, "its statistics count other messages by channel"),
        (record(MESSAGE, 0, 7), 1, "its statistics name log times"),
    ],
)
def test_a_changed_bit_outside_of_chunks_is_told(
    tmp_path: Path, kind: str, place: Callable[[bytes], int], mask: int, told: str
) -> None:
    sound = sound_recording(kind)
    path = altered(tmp_path, sound, place, mask)
    messages, losses = read_all(path, "as_needed")
    assert [message.data for message in messages] == [message.data for message in sound.messages] or losses
    assert any(text in loss.reason for loss in losses for text in told.split("|")), losses
    with pytest.raises(RecordingError, match="damaged"):
        read_all(path, "none")


def test_the_name_under_a_checksum_is_used(tmp_path: Path) -> None:
    sound = sound_recording("mcap-no-chunks")
    messages, _ = read_all(altered(tmp_path, sound, first(b"/odom", 1), 1), "as_needed")
    assert {message.name for message in messages} == {message.name for message in sound.messages}


def test_the_checksum_of_the_data_is_compared_where_there_are_no_chunks(tmp_path: Path) -> None:
    sound = sound_recording("mcap-no-chunks")
    path = altered(tmp_path, sound, record(MESSAGE, 3, 100), 1)
    messages, (loss,) = read_all(path, "as_needed")
    assert len(messages) == len(sound.messages)
    assert "the checksum of its data is wrong" in loss.reason


def test_a_record_that_no_chunk_holds_is_told(tmp_path: Path) -> None:
    """A definition whose kind was changed is not there to be compared."""
    path = tmp_path / "a.mcap"
    state = raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=5), 5, 5)
    write_mcap(path, [state], "none", enable_crcs=False)
    content = bytearray(path.read_bytes())
    kind = (
        content.index(b"nav_msgs/msg/Odometry") - 15
    )  # before the name: opcode, size, id, size of the name
    assert content[kind] == 3
    content[kind] = FOOTER
    path.write_bytes(content)
    messages, losses = read_all(path, "as_needed")
    assert len(messages) == 1
    assert "a record with opcode 2 in a chunk, where none may be" in losses[0].reason


def test_an_index_that_cannot_be_read_costs_nothing(tmp_path: Path) -> None:
    sound = sound_recording("mcap-no-crc")
    messages, losses = read_all(altered(tmp_path, sound, record(MESSAGE_INDEX, 0, 2), 1), "as_needed")
    assert messages == sound.messages
    assert losses
