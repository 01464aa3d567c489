"""The records of a chunk, sound and hostile."""

import struct
import time
from io import BytesIO

import pytest

from pipeline.core.settings.recording import LimitsConfig
from readers.files.rosbag1.chunk import Entry, compared, messages_of
from readers.files.rosbag1.records import find_record


def message(time_s: int, data: bytes, connection: int = 1, size: int | None = None) -> bytes:
    header = b"\x04\0\0\0op=\x02\x09\0\0\0conn=" + struct.pack("<I", connection)
    header += b"\x0d\0\0\0time=" + struct.pack("<II", time_s, 0)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data) if size is None else size) + data


def entries(records: bytes) -> list[Entry]:
    found, _ = messages_of(BytesIO(records), 0, len(records), LimitsConfig())
    return [one.entry for one in found]


def test_no_one_and_many_messages() -> None:
    one = message(3, b"abc")
    assert entries(b"") == []
    assert entries(one) == [Entry(3 * 10**9, 0, 1)]
    assert entries(one + message(4, b"", 2)) == [Entry(3 * 10**9, 0, 1), Entry(4 * 10**9, len(one), 2)]


def test_a_message_of_a_wrong_length_is_passed_over() -> None:
    records = message(1, b"abc", size=2) + message(2, b"abc")
    assert [entry.log_time_ns for entry in entries(records)] == [2 * 10**9]


def test_too_many_messages_are_refused() -> None:
    with pytest.raises(ValueError, match="max_messages_per_chunk"):
        messages_of(BytesIO(message(1, b"") * 3), 0, 3 * len(message(1, b"")), LimitsConfig(max_messages_per_chunk=2))


def test_what_index_and_chunk_have_in_common() -> None:
    records = message(1, b"abc") + message(2, b"abc")
    found, _ = messages_of(BytesIO(records), 0, len(records), LimitsConfig())
    first, second = (one.entry for one in found)
    wrong = second._replace(connection_id=9)
    comparison = compared([first, wrong, first], found)
    assert [one.entry for one in comparison.agreed] == [first]
    assert comparison.only_indexed == [wrong, first]
    assert [one.entry for one in comparison.unlisted] == [second]


def test_many_false_records_take_no_longer_than_their_bytes() -> None:
    """Each was followed by a search through a whole megabyte."""
    records = message(1, b"abcde") + b"x"
    chunk = records * 40_000
    started = time.process_time()
    assert len(entries(chunk)) <= 40_000
    assert time.process_time() - started < 8


def test_a_record_beyond_the_first_block_is_found() -> None:
    content = bytes(100_000) + message(1, b"abc")
    assert find_record(BytesIO(content), 0, len(content)) == 100_000
    assert find_record(BytesIO(content), 100_001, len(content)) == len(content)
