"""What is told of a chunk at once, against its records read one by one."""

import struct
from io import BytesIO

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.arrays import I64
from pipeline.core.settings.recording import LimitsConfig
from readers.files.rosbag1.as_listed import as_listed
from readers.files.rosbag1.chunk import Entry, compared, messages_of


def field(name: bytes, value: bytes) -> bytes:
    return struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value


def message(time_s: int, connection: int, data: bytes, *, conn_first: bool = False) -> bytes:
    fields = [field(b"op", b"\x02"), field(b"conn", struct.pack("<I", connection))]
    fields = [*(fields[::-1] if conn_first else fields), field(b"time", struct.pack("<II", time_s, 5))]
    header = b"".join(fields)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def connection(id_: int) -> bytes:
    header = field(b"op", b"\x07") + field(b"conn", struct.pack("<I", id_)) + field(b"topic", b"/t")
    data = field(b"topic", b"/t") + field(b"type", b"a/B")
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def chunk_of(records: list[bytes]) -> tuple[bytes, I64]:
    """A chunk, and rows of its messages as an index has them."""
    chunk = b"".join(records)
    found, _ = messages_of(BytesIO(chunk), 0, len(chunk), LimitsConfig())
    rows = [(one.entry.log_time_ns, one.entry.offset, one.entry.connection_id) for one in found]
    return chunk, np.array(rows, np.int64).reshape(-1, 3)


def judged(chunk: bytes, rows: I64) -> tuple[list[tuple[int, int, int]], list[int]] | None:
    """Offset, place and size of each message, and where connections begin; None if the index does not fit."""
    found, connections = messages_of(BytesIO(chunk), 0, len(chunk), LimitsConfig())
    entries = [Entry(log_time_ns, offset, id_) for log_time_ns, offset, id_ in rows[np.argsort(rows[:, 1])].tolist()]
    comparison = compared(entries, found)
    if comparison.only_indexed or comparison.unlisted:
        return None
    places = [(one.entry.offset, one.data_at, one.size) for one in comparison.agreed]
    return places, [record.start for record in connections]


def told(chunk: bytes, rows: I64) -> tuple[list[tuple[int, int, int]], list[int]] | None:
    listed = as_listed(chunk, rows)
    if listed is None:
        return None
    columns = listed.offsets.tolist(), listed.data_at.tolist(), listed.sizes.tolist()
    return [*zip(*columns, strict=True)], [record.start for record in listed.connections]


RECORDS = st.lists(
    st.one_of(
        st.builds(message, st.integers(0, 3), st.integers(0, 2), st.binary(max_size=5)),
        st.builds(connection, st.integers(0, 2)),
    ),
    max_size=8,
)


@given(RECORDS)
def test_a_sound_chunk_is_told_in_full(records: list[bytes]) -> None:
    chunk, rows = chunk_of(records)
    assert told(chunk, rows[::-1]) == (judged(chunk, rows) if len(rows) else None)


@given(RECORDS, st.data())
def test_of_a_damaged_one_nothing_wrong_is_told(records: list[bytes], data: st.DataObject) -> None:
    chunk, rows = chunk_of(records)
    if not len(rows):
        return
    damaged = bytearray(chunk)
    for _ in range(data.draw(st.integers(0, 2))):
        damaged[data.draw(st.integers(0, len(chunk) - 1))] = data.draw(st.sampled_from([0, 1, 2, 7, 255]))
    rows = rows.copy()
    rows[data.draw(st.integers(0, len(rows) - 1)), data.draw(st.integers(0, 2))] += data.draw(st.integers(0, 1))
    found = told(bytes(damaged), rows)
    assert found is None or found == judged(bytes(damaged), rows)


def test_the_index_may_name_a_connection_before_the_message() -> None:
    chunk, rows = chunk_of([message(1, 0, b"a"), connection(1), message(2, 1, b"bc")])
    rows[1, 1] = len(message(1, 0, b"a"))
    assert told(chunk, rows) is not None
    assert told(chunk, rows) == judged(chunk, rows)


def test_what_the_index_does_not_list_and_other_layouts_are_left_to_others() -> None:
    chunk, rows = chunk_of([message(1, 0, b"a"), message(2, 0, b"bc")])
    assert told(chunk, rows) is not None
    assert told(chunk, rows[:1]) is None
    assert told(chunk + b"x", rows) is None
    assert told(chunk[:-1], rows) is None
    assert told(chunk, np.zeros((0, 3), np.int64)) is None
    chunk, rows = chunk_of([message(1, 0, b"a"), message(2, 0, b"bc", conn_first=True)])
    assert told(chunk, rows) is None
