"""What is told of a chunk at once, against its records read one by one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from pipeline.core.arrays import I64
from pipeline.core.settings.recording import LimitsConfig
from readers.files.mcap.as_listed import as_listed
from readers.files.mcap.chunk import MESSAGE_HEAD, RECORD_HEAD, Entry, entry_of, records_in

HEAD_BYTES = RECORD_HEAD.size + MESSAGE_HEAD.size


def record(opcode: int, content: bytes) -> bytes:
    return RECORD_HEAD.pack(opcode, len(content)) + content


def message(channel_id: int, log_time_ns: int, data: bytes) -> bytes:
    return record(Opcode.MESSAGE, MESSAGE_HEAD.pack(channel_id, 1, log_time_ns, 2) + data)


Told = tuple[list[Entry], list[tuple[int, int, int]]]


def walked(chunk: bytes) -> Told | None:
    """Messages and definitions; None if there is something else, or damage."""
    entries, definitions = [], []
    try:
        for opcode, at, size in records_in(chunk, LimitsConfig()):
            if opcode == Opcode.MESSAGE:
                entries.append(entry_of(chunk, at, 7, at, size))
            elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                definitions.append((opcode, at, size))
            else:
                return None
    except Exception:
        return None
    return entries, definitions


def rows_of(entries: list[Entry]) -> I64:
    rows = [(entry.offset - HEAD_BYTES, entry.log_time_ns, entry.channel_id) for entry in entries]
    return np.array(rows, np.int64).reshape(-1, 3)


def told(chunk: bytes, rows: I64) -> Told | None:
    listed = as_listed(chunk, rows)
    return None if listed is None else (listed.entries(7, range(300)), listed.definitions)


RECORDS = st.lists(
    st.one_of(
        st.builds(message, st.integers(0, 2), st.integers(0, 3), st.binary(max_size=5)),
        st.builds(record, st.sampled_from([Opcode.SCHEMA, Opcode.CHANNEL]), st.binary(max_size=5)),
    ),
    max_size=8,
)


@given(RECORDS)
def test_a_sound_chunk_is_told_in_full(records: list[bytes]) -> None:
    chunk = b"".join(records)
    expected = walked(chunk)
    assert expected is not None
    rows = rows_of(expected[0])
    assert told(chunk, rows[::-1]) == (expected if len(rows) else None)
    if len(rows):
        listed = as_listed(chunk, rows)
        assert listed is not None
        assert listed.entries(7, {1}) == [entry for entry in expected[0] if entry.channel_id == 1]


@given(RECORDS, st.data())
def test_of_a_damaged_one_nothing_wrong_is_told(records: list[bytes], data: st.DataObject) -> None:
    chunk = b"".join(records)
    expected = walked(chunk)
    assert expected is not None
    rows = rows_of(expected[0])
    if not len(rows):
        return
    damaged = bytearray(chunk)
    for _ in range(data.draw(st.integers(0, 2))):
        damaged[data.draw(st.integers(0, len(chunk) - 1))] = data.draw(st.sampled_from([0, 1, 4, 5, 128, 255]))
    rows[data.draw(st.integers(0, len(rows) - 1)), data.draw(st.integers(0, 2))] += data.draw(st.integers(-1, 1))
    found = told(bytes(damaged), rows)
    assert found is None or found == walked(bytes(damaged))


def test_what_the_index_does_not_list_is_left_to_others() -> None:
    chunk = message(1, 5, b"a") + message(2, 6, b"bc")
    expected = walked(chunk)
    assert expected is not None
    rows = rows_of(expected[0])
    assert told(chunk, rows) == expected
    assert told(chunk, rows[:1]) is None
    assert told(chunk, rows[1:]) is None
    assert told(chunk, np.zeros((0, 3), np.int64)) is None
    assert told(chunk[:-1], rows) is None
    assert told(chunk + b"x", rows) is None
    assert told(chunk + record(Opcode.CHUNK, b""), rows) is None
    assert told(chunk, np.r_[rows, rows[:1]]) is None
