"""Contents of an MCAP file according to its summary section."""

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.records import Channel, ChunkIndex, Footer, Header, Schema, Statistics
from mcap.stream_reader import StreamReader

from lidcam.readers.files.chunked import ChunkPlace, Entry
from lidcam.readers.files.container import read_exactly
from lidcam.readers.files.mcap.records import INDEX_HEAD, PAIR_BYTES, RECORD_HEAD

FOOTER = struct.Struct("<BQQQI")  # record head, start of the summary, start of its offsets, crc of the summary
MAGIC_BYTES = 8
BLOCK_BYTES = 1 << 20
MAX_RECORD_BYTES = 1 << 26
"""Largest record of a summary: a schema, or the index of a chunk."""


@dataclass(slots=True)
class Contents:
    """Contents of a file, and their places."""

    schemas: dict[int, Schema] = field(default_factory=dict)  # By id
    channels: dict[int, Channel] = field(default_factory=dict)  # By id
    counts: Counter[int] = field(default_factory=Counter)  # Number of messages by channel id
    chunks: list[ChunkPlace] = field(default_factory=list)  # Where the chunks are
    loose: list[Entry] = field(default_factory=list)  # Messages outside of chunks
    start_ns: int = 2**64  # Log time of the first message
    end_ns: int = 0  # Log time of the last message (inclusive)


def _reader(stream: BinaryIO, position: int, whence: int = 0) -> StreamReader:
    """Records from a position on, chunks as they are."""
    stream.seek(position, whence)
    return StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES)


def read_profile(stream: BinaryIO) -> str:
    """The profile that the header names.

    Raises:
        Exception: of the mcap library, if there is no header.
    """
    header = next(_reader(stream, MAGIC_BYTES).records)
    if not isinstance(header, Header):
        raise McapError(f"expected a header, found {type(header).__name__}")
    return header.profile


def contents_of_summary(stream: BinaryIO) -> Contents | None:
    """Contents according to the summary section; None if it lacks something.

    Raises:
        ValueError: its checksum is wrong, or it contradicts itself.
        Exception: of the mcap library, if it is damaged.
    """
    footer = next(_reader(stream, -FOOTER.size - MAGIC_BYTES, 2).records)
    if not isinstance(footer, Footer):
        raise McapError(f"expected a footer, found {type(footer).__name__}")
    if not is_summary_sound(stream):
        raise ValueError("the checksum of its summary is wrong")
    contents = Contents()
    statistics: Statistics | None = None
    for record in _reader(stream, footer.summary_start).records if footer.summary_start else ():
        match record:
            case Statistics():
                statistics = record
            case Schema():
                contents.schemas[record.id] = record
            case Channel():
                contents.channels[record.id] = record
            case ChunkIndex():
                contents.chunks.append(_place_of(record))
    if statistics is None:
        return None
    contents.counts = Counter(statistics.channel_message_counts)
    contents.start_ns, contents.end_ns = statistics.message_start_time, statistics.message_end_time
    counts = [place.messages for place in contents.chunks if place.messages is not None]
    if len(counts) == len(contents.chunks) and counts and sum(counts) != statistics.message_count:
        raise ValueError(
            f"its statistics say {statistics.message_count} messages, the index of its chunks {sum(counts)}"
        )
    is_complete = (
        contents.counts.total() == statistics.message_count
        and len(contents.chunks) == statistics.chunk_count
        and (contents.chunks or not statistics.message_count)
        and contents.counts.keys() <= contents.channels.keys()
        and {channel.schema_id for channel in contents.channels.values()} <= {0, *contents.schemas}
    )
    return contents if is_complete else None


def _place_of(record: ChunkIndex) -> ChunkPlace:
    """A chunk by its record in the summary; the size of the message indexes behind it says how many messages it has."""
    ids = frozenset(record.message_index_offsets)
    pairs, rest = divmod(record.message_index_length - len(ids) * (RECORD_HEAD.size + INDEX_HEAD.size), PAIR_BYTES)
    count = pairs if ids and not rest and pairs >= 0 else None
    start_ns, end_ns = record.message_start_time, record.message_end_time
    return ChunkPlace(start_ns, record.chunk_start_offset, end_ns, ids, record.chunk_length, count)


def is_summary_sound(stream: BinaryIO) -> bool:
    """Whether the summary has the checksum (CRC-32) that the footer names, if it names one.

    Raises:
        OSError: the file is shorter than a footer.
        EOFError: the footer names a place beyond the file.
    """
    end = stream.seek(-FOOTER.size - MAGIC_BYTES, 2)
    _, _, start, _, crc = FOOTER.unpack(read_exactly(stream, FOOTER.size))
    if not crc or not start:
        return True
    stream.seek(start)
    found, left = 0, end + FOOTER.size - 4 - start  # all but itself
    while left > 0:
        block = read_exactly(stream, min(left, BLOCK_BYTES))
        found, left = zlib.crc32(block, found), left - len(block)
    return bool(found == crc)


def end_of_records(stream: BinaryIO) -> int:
    """End of the last record: before the magic bytes, if the file ends with them."""
    size = stream.seek(0, 2)
    stream.seek(0)
    magic = stream.read(MAGIC_BYTES)
    stream.seek(max(size - MAGIC_BYTES, 0))
    return size - MAGIC_BYTES if size > MAGIC_BYTES and stream.read() == magic else size
