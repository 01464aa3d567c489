"""The messages of a chunk where it is just as the index behind it says, all of them compared at once.

A chunk may have thousands of tiny messages of which one is wanted. Where the index explains every byte of it but for
schemas and channels, its records need not be read one by one. Of any other chunk nothing is said here.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from pipeline.core.arrays import I64
from readers.files.mcap.chunk import MESSAGE_HEAD, RECORD_HEAD, Entry

__all__ = ["Listed", "as_listed"]

HEAD_BYTES = RECORD_HEAD.size + MESSAGE_HEAD.size
HEAD = np.dtype(
    [("op", "u1"), ("size", "<i8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<i8"), ("publish_ns", "<i8")]
)
"""Of a message: the head of its record, and its fields before the data."""


class Listed(NamedTuple):
    """The messages of a chunk.

    Attributes:
        rows: (N, 4) log time, first byte and size of the data, and channel.
        definitions: Opcode, start and size of the content of each record of a schema or a channel.
    """

    rows: I64
    definitions: list[tuple[int, int, int]]

    def entries(self, chunk_position: int, channel_ids: Collection[int]) -> list[Entry]:
        """The messages of some channels."""
        rows = self.rows[np.isin(self.rows[:, 3], [*channel_ids])]
        return [Entry(log_ns, chunk_position, at, size, id_) for log_ns, at, size, id_ in rows.tolist()]


def as_listed(records: bytes, rows: I64) -> Listed | None:
    """The messages of a chunk; None unless it has just those that its index lists, and schemas and channels.

    Args:
        records: The unpacked chunk.
        rows: (N, 3) first byte of its record, log time and channel of all messages that the index lists, in any order.
    """
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    starts, end = rows[:, 0], len(records)
    if not len(rows) or starts[0] < 0 or starts[-1] + HEAD_BYTES > end:
        return None
    content = np.frombuffer(records, np.uint8)
    heads = np.lib.stride_tricks.sliding_window_view(content, HEAD_BYTES)[starts].view(HEAD)[:, 0]
    sizes = heads["size"] - MESSAGE_HEAD.size
    is_right = (heads["op"] == Opcode.MESSAGE) & (sizes >= 0) & (sizes <= end) & (rows[:, 1] >= 0)
    if not (is_right & (heads["log_ns"] == rows[:, 1]) & (heads["channel"] == rows[:, 2])).all():
        return None
    data_at = starts + HEAD_BYTES
    definitions: list[tuple[int, int, int]] = []
    ends, nexts = np.r_[0, data_at + sizes], np.r_[starts, end]
    for place in np.flatnonzero(ends != nexts).tolist():
        at, following = int(ends[place]), int(nexts[place])
        while at + RECORD_HEAD.size <= following:
            opcode, size = RECORD_HEAD.unpack_from(records, at)
            if opcode not in {Opcode.SCHEMA, Opcode.CHANNEL}:
                return None
            definitions.append((opcode, at + RECORD_HEAD.size, size))
            at += RECORD_HEAD.size + size
        if at != following:
            return None
    return Listed(np.stack([rows[:, 1], data_at, sizes, rows[:, 2]], axis=1), definitions)
