"""Where passes of the recorder's clock begin in an MCAP file, by the indexes of messages behind its chunks.

These are read only where the times of the chunks allow of a jump, so that opening an ordinary file takes no longer.
"""

import struct
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode

from readers.files.mcap.chunk import RECORD_HEAD, Entry, read_exactly
from readers.files.mcap.index import ChunkPlace
from readers.files.passes import JUMP_NS, pass_starts

__all__ = ["INDEX_HEAD", "PAIR_BYTES", "FilePlace", "indexed_messages", "pass_places"]

FilePlace = tuple[int, int]
"""Byte of the chunk, or of the message outside of chunks; then the byte within the chunk."""

INDEX_HEAD = struct.Struct("<HI")  # channel, bytes of pairs of log time and offset
PAIR_BYTES = 16


def pass_places(stream: BinaryIO, chunks: Sequence[ChunkPlace], loose: Sequence[Entry]) -> list[FilePlace]:
    """The first place of each pass but the first; mostly none.

    Raises:
        EOFError: the file ends within an index.
        struct.error: an index is damaged.
        ValueError: an index is damaged.
    """
    if not _may_jump(chunks, loose) and not _jumps_at_the_end(stream, chunks):
        return []
    places = [(entry.offset, 0, entry.log_time_ns, entry.channel_id) for entry in loose]
    table = np.array(places, np.int64).reshape(-1, 4)
    indexed = [table, *(indexed_messages(stream, chunk) for chunk in chunks)]
    table = np.concatenate(indexed)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    return [(int(table[row, 0]), int(table[row, 1])) for row in pass_starts(table[:, 2], table[:, 3])]


def _may_jump(chunks: Sequence[ChunkPlace], loose: Sequence[Entry]) -> bool:
    """Whether anything lies in the file behind something of later log times."""
    spans = [(chunk.position, chunk.start_ns, chunk.end_ns) for chunk in chunks if chunk.end_ns]
    spans += [(entry.offset, entry.log_time_ns, entry.log_time_ns) for entry in loose]
    latest_ns = 0
    for _, start_ns, end_ns in sorted(spans):
        if start_ns < latest_ns - JUMP_NS:
            return True
        latest_ns = max(latest_ns, end_ns)
    return False


def _jumps_at_the_end(stream: BinaryIO, chunks: Sequence[ChunkPlace]) -> bool:
    """Whether log times jump back within the last chunk: no chunk follows that would show it."""
    last = max(chunks, key=lambda chunk: chunk.position, default=None)
    if last is None or last.end_ns - last.start_ns <= JUMP_NS:
        return False
    table = indexed_messages(stream, last)
    log_times_ns = table[np.argsort(table[:, 1]), 2]
    return bool(len(table)) and bool((np.maximum.accumulate(log_times_ns) - log_times_ns).max() > JUMP_NS)


def indexed_messages(stream: BinaryIO, chunk: ChunkPlace) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """(N, 4) places, log times and channels of the messages of a chunk, from the index records that follow it."""
    found = []
    stream.seek(chunk.position + chunk.size)
    while True:
        opcode, size = RECORD_HEAD.unpack(read_exactly(stream, RECORD_HEAD.size))
        if opcode != Opcode.MESSAGE_INDEX:
            break
        content = read_exactly(stream, size)
        channel_id, pair_bytes = INDEX_HEAD.unpack_from(content)
        pairs = np.frombuffer(content, "<u8", pair_bytes // PAIR_BYTES * 2, INDEX_HEAD.size).reshape(-1, 2)
        columns = np.full(len(pairs), chunk.position), pairs[:, 1], pairs[:, 0], np.full(len(pairs), channel_id)
        found.append(np.stack([column.astype(np.int64) for column in columns], axis=1))
    return np.concatenate([np.zeros((0, 4), np.int64), *found])
