"""The messages of a chunk where it is just as its index says, all of them compared at once.

A chunk may have thousands of tiny messages of which one is wanted. Where every byte of it is explained by its index,
and by records of connections, nothing needs to be sought: this is what nearly all chunks are like. Of any other chunk
nothing is said here; its records are read one by one.
"""

from io import BytesIO
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import I64
from readers.files.rosbag1.records import CONNECTION, MESSAGE_BEGIN, Record, read_record

__all__ = ["Listed", "as_listed"]

HEADER_BYTES = 38
"""Of a message's header without other fields."""

DATA_AT = 4 + HEADER_BYTES + 4
"""First byte of a message's data, from the beginning of its record."""


class Listed(NamedTuple):
    """The messages of a chunk.

    Attributes:
        offsets: (N,) as the index gives them, sorted.
        data_at: (N,) first bytes of their data.
        sizes: (N,) bytes of their data.
        connections: The records of connections between them.
    """

    offsets: I64
    data_at: I64
    sizes: I64
    connections: list[Record]


def as_listed(records: bytes, rows: I64) -> Listed | None:
    """The messages of a chunk; None unless it has just those that its index lists, and records of connections.

    Args:
        records: The unpacked chunk.
        rows: (N, 3) log time, offset and connection id of all messages that the index lists; in any order.
    """
    if not len(rows):
        return None
    rows = rows[np.argsort(rows[:, 1])]
    content, offsets, end = np.frombuffer(records, np.uint8), rows[:, 1], len(records)
    if offsets[-1] + DATA_AT > end:
        return None
    stream, connections = BytesIO(records), list[Record]()
    starts = offsets.copy()
    heads = np.lib.stride_tricks.sliding_window_view(content, DATA_AT)
    for place in np.flatnonzero(_numbers(heads[starts, :4]) != HEADER_BYTES).tolist():
        # some writers index the record of the connection before the message
        begin = int(starts[place])
        starts[place] = _behind_connections(stream, begin, end, connections)
        if starts[place] == begin or starts[place] + DATA_AT > end:
            return None
    found = heads[starts]
    layout = MESSAGE_BEGIN.match(found[0].tobytes())
    if layout is None or None in layout.groups():
        return None
    is_own = np.zeros(DATA_AT, bool)  # bytes that differ from message to message
    for group in (1, 3, 4):
        is_own[slice(*layout.span(group))] = True
    if (found[:, ~is_own] != found[0, ~is_own]).any():
        return None
    conn, time, size = (found[:, slice(*layout.span(group))] for group in (1, 3, 4))
    times_ns = _numbers(time[:, :4]) * 10**9 + _numbers(time[:, 4:])
    if (times_ns != rows[:, 0]).any() or (_numbers(conn) != rows[:, 2]).any():
        return None
    data_at, sizes = starts + DATA_AT, _numbers(size)
    ends, nexts = np.r_[0, data_at + sizes], np.r_[offsets, end]
    for place in np.flatnonzero(ends != nexts).tolist():
        reached = _behind_connections(stream, int(ends[place]), int(nexts[place]), connections)
        if reached != nexts[place]:
            return None
    return Listed(offsets, data_at, sizes, sorted(connections, key=lambda record: record.start))


def _behind_connections(stream: BytesIO, begin: int, end: int, found: list[Record]) -> int:
    """Where the records of connections that begin at `begin` end."""
    while (record := read_record(stream, begin, end)) is not None and record.kind == CONNECTION:
        found.append(record)
        begin = record.end
    return begin


def _numbers(columns: np.ndarray[tuple[int, int], np.dtype[np.uint8]]) -> I64:
    """The unsigned 32-bit numbers in rows of four bytes."""
    return np.ascontiguousarray(columns).view("<u4")[:, 0].astype(np.int64)
