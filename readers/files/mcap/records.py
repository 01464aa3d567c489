"""The records of an MCAP file (https://mcap.dev/spec): the one at a position, or the next one after damage."""

import re
import struct
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from readers.files.mcap.chunk import CHUNK_HEAD, MESSAGE_HEAD, RECORD_HEAD, UINT64, read_chunk_head
from readers.files.mcap.index import FOOTER, MAGIC_BYTES

__all__ = [
    "OPCODES",
    "Record",
    "end_of_records",
    "find_record",
    "listed_messages",
    "record_at",
    "summary_start",
]

INDEX_HEAD = struct.Struct("<HI")  # channel, bytes of the entries
INDEX_ENTRY_BYTES = 16

MIN_BYTES: dict[int, int] = {
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: MESSAGE_HEAD.size,
    Opcode.CHUNK: CHUNK_HEAD.size + UINT64.size,
    Opcode.MESSAGE_INDEX: INDEX_HEAD.size,
    Opcode.STATISTICS: 46,
    Opcode.DATA_END: 4,
}
MAX_BYTES: dict[int, int] = {Opcode.FOOTER: 20, Opcode.DATA_END: 4}

OPCODES = range(Opcode.HEADER, Opcode.DATA_END + 1)
PRIVATE_OPCODES = range(0x80, 0x100)
"""Records of applications, which readers skip."""

# An opcode, and a length below 2^40.
RECORD_START = re.compile(rb"(?s)(?=[\x01-\x0f].{5}\x00{3}).")
FIRST_BLOCK, SEARCH_BLOCK = 1 << 12, 1 << 20
"""Bytes that are searched at once, more from one time to the next: what is sought is mostly near."""


class Record(NamedTuple):
    """One record: its content begins at byte `content` and takes up `size`."""

    opcode: int
    start: int
    content: int
    size: int

    @property
    def end(self) -> int:
        """The byte after it."""
        return self.content + self.size


def listed_messages(index: Record) -> int:
    """Number of messages that the index of a chunk lists."""
    return (index.size - INDEX_HEAD.size) // INDEX_ENTRY_BYTES


def end_of_records(stream: BinaryIO) -> int:
    """Where the last record ends: before the magic bytes, if the file ends with them."""
    size = stream.seek(0, 2)
    stream.seek(0)
    magic = stream.read(MAGIC_BYTES)
    stream.seek(max(size - MAGIC_BYTES, 0))
    return size - MAGIC_BYTES if size > MAGIC_BYTES and stream.read() == magic else size


def summary_start(stream: BinaryIO, end: int) -> int | None:
    """Where the summary begins according to the footer; None if there is no footer."""
    footer = record_at(stream, max(end - FOOTER.size, 0), end)
    if footer is None or footer.opcode != Opcode.FOOTER:
        return None
    stream.seek(footer.content)
    return int(UINT64.unpack(stream.read(UINT64.size))[0])


def record_at(stream: BinaryIO, position: int, end: int) -> Record | None:
    """The record at `position`; None if no complete record begins there."""
    record = _frame_at(stream, position, end)
    if record is None:
        return None
    opcode, size = record.opcode, record.size
    if opcode in PRIVATE_OPCODES:  # any bytes may look like one, so look at what follows
        return record if record.end == end or _frame_at(stream, record.end, end) else None
    if not MIN_BYTES.get(opcode, 0) <= size <= MAX_BYTES.get(opcode, size):
        return None
    if opcode == Opcode.MESSAGE_INDEX:
        _, listed = INDEX_HEAD.unpack(stream.read(INDEX_HEAD.size))
        return record if size == listed + INDEX_HEAD.size and not listed % INDEX_ENTRY_BYTES else None
    if opcode == Opcode.CHUNK:
        try:
            head = read_chunk_head(stream)
        except (EOFError, ValueError):
            return None
        return record if head.position + head.size == record.end else None
    return record


def _frame_at(stream: BinaryIO, position: int, end: int) -> Record | None:
    """A record by its opcode and length alone."""
    if position + RECORD_HEAD.size > end:
        return None
    stream.seek(position)
    opcode, size = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
    content = position + RECORD_HEAD.size
    if content + size > end or (opcode not in OPCODES and opcode not in PRIVATE_OPCODES):
        return None
    return Record(opcode, position, content, size)


def find_record(stream: BinaryIO, position: int, end: int) -> int:
    """Where the next records begin at or after `position`; `end` if none do."""
    step = FIRST_BLOCK
    while position < end:
        stream.seek(position)
        block = stream.read(min(step, end - position))
        for match in RECORD_START.finditer(block):
            if _begins(stream, position + match.start(), end):
                return position + match.start()
        if position + len(block) >= end:
            return end
        position += len(block) - RECORD_HEAD.size
        step = min(2 * step, SEARCH_BLOCK)
    return end


def _begins(stream: BinaryIO, position: int, end: int) -> bool:
    """Whether a chunk, or three records in a row, begin at `position`."""
    for _ in range(3):
        record = record_at(stream, position, end)
        if record is None:
            return False
        if record.opcode in {Opcode.CHUNK, Opcode.MESSAGE_INDEX} or record.end == end:
            return True
        position = record.end
    return True
