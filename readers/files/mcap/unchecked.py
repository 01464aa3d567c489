"""MCAP files whose writer left out checksums: what they say twice is compared instead.

Only what needs no chunk to be unpacked is compared when a file is opened; a chunk without a checksum is compared with
the index behind it when it is read.
"""

import struct
from collections import Counter
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode

from pipeline.core.settings.recording import LimitsConfig
from readers.files.container import MAX_BYTES_AT_OPENING
from readers.files.mcap.chunk import (
    CHUNK_HEAD,
    MESSAGE_HEAD,
    RECORD_HEAD,
    Entry,
    load_chunk,
    read_chunk_head,
    read_exactly,
    records_in,
)
from readers.files.mcap.definitions import Definitions
from readers.files.mcap.index import MAGIC_BYTES, ChunkPlace, Contents
from readers.files.mcap.passes import INDEX_HEAD, PAIR_BYTES, indexed_messages
from readers.files.mcap.records import record_at, summary_start

__all__ = ["agrees_with_index", "check_places", "confirm_definitions"]


def check_places(stream: BinaryIO, contents: Contents) -> None:
    """Compare a summary without a checksum with all records of the data but for what is in the chunks.

    Raises:
        ValueError: they differ.
        EOFError: the file ends early.
    """
    end = stream.seek(0, 2) - MAGIC_BYTES
    places = {chunk.position: chunk for chunk in contents.chunks}
    chunk: ChunkPlace | None = None
    channels: dict[int, set[int]] = {position: set() for position in places}
    counts: Counter[int] = Counter()
    position = MAGIC_BYTES
    while (record := record_at(stream, position, end)) is not None and record.opcode != Opcode.DATA_END:
        if record.opcode == Opcode.MESSAGE:
            raise ValueError(f"a message outside of the chunks, at byte {position}, which its summary does not list")
        if record.opcode == Opcode.CHUNK:
            chunk = places.pop(position, None)
            stream.seek(record.content)
            start_ns, end_ns, *_ = CHUNK_HEAD.unpack(read_exactly(stream, CHUNK_HEAD.size))
            if chunk is None or (chunk.start_ns, chunk.end_ns, chunk.size) != (start_ns, end_ns, record.end - position):
                raise ValueError(f"the chunk at byte {position} is another one than its summary says")
        elif record.opcode == Opcode.MESSAGE_INDEX and chunk is not None:
            stream.seek(record.content)
            id_, size = INDEX_HEAD.unpack(read_exactly(stream, INDEX_HEAD.size))
            counts[id_] += size // PAIR_BYTES
            channels[chunk.position] |= {id_} if size else set()
        position = record.end
    if record is None or places or record.end != summary_start(stream, end):
        raise ValueError(f"its data do not end, at byte {position}, where its summary says")
    if counts and counts != +contents.counts:
        raise ValueError("its summary counts other messages than the indexes behind the chunks")
    if counts and any(channels[chunk.position] != chunk.channel_ids for chunk in contents.chunks):
        raise ValueError("its summary names other channels in a chunk than the indexes behind it")
    spans = [(chunk.start_ns, chunk.end_ns) for chunk in contents.chunks]
    if spans and (contents.start_ns, contents.end_ns) != (min(spans)[0], max(end_ns for _, end_ns in spans)):
        raise ValueError("its summary names other times of the recording than of the chunks")


def confirm_definitions(
    stream: BinaryIO, chunks: Sequence[ChunkPlace], definitions: Definitions, limits: LimitsConfig
) -> None:
    """Compare schemas and channels with the first chunks in which each has messages.

    Raises:
        Exception: any that damage causes.
    """
    confirmed: set[int] = set()
    left = MAX_BYTES_AT_OPENING
    for chunk in sorted(chunks, key=lambda chunk: chunk.position):
        stream.seek(chunk.position + RECORD_HEAD.size)
        head = read_chunk_head(stream)
        left -= head.uncompressed_size
        if left < 0:
            return
        if chunk.channel_ids and chunk.channel_ids <= confirmed:
            continue
        records = load_chunk(stream, chunk.position, limits)
        for opcode, at, size in records_in(records, limits):
            definitions.add(opcode, records[at : at + size], chunk.position, is_checked=bool(head.crc))
        confirmed |= chunk.channel_ids


def agrees_with_index(stream: BinaryIO, chunk: ChunkPlace, entries: Sequence[Entry]) -> bool:
    """Whether the messages of a chunk are those of the index behind it; true if it has a checksum, or no index.

    Raises:
        Exception: any that damage to the chunk causes.
    """
    stream.seek(chunk.position + RECORD_HEAD.size)
    if read_chunk_head(stream).crc:
        return True
    try:
        listed = indexed_messages(stream, chunk)[:, 1:]
    except (EOFError, ValueError, struct.error):
        return False
    if not len(listed):
        return True
    head = RECORD_HEAD.size + MESSAGE_HEAD.size  # the index names records, entries the data in them
    found = np.array([(e.offset - head, e.log_time_ns, e.channel_id) for e in entries], np.int64).reshape(-1, 3)
    return np.array_equal(listed[np.lexsort(listed.T)], found[np.lexsort(found.T)])
