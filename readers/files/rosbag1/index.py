"""What a ROS 1 bag contains and where, according to its index."""

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import decompressors, read_bytes

from pipeline.core.arrays import I64
from pipeline.core.messages import Channel
from pipeline.core.settings.recording import LimitsConfig
from readers.files.decompress import Unpacked, unpack, unpack_lz4
from readers.files.rosbag1.records import CHUNK, read_record

__all__ = ["Chunk", "Contents", "by_time", "check_complete", "contents_of_index", "load_chunk"]


class Chunk(NamedTuple):
    """Where a chunk's data are.

    Attributes:
        data_position: First byte of the data.
        data_size: Bytes of the data; 0 if unknown.
        compression: `none`, `bz2` or `lz4`.
        is_cut: Whether the file ends inside them.
    """

    data_position: int
    data_size: int
    compression: str
    is_cut: bool = False


@dataclass(frozen=True, slots=True)
class Contents:
    """What a bag contains and where.

    Attributes:
        channels: By connection id.
        chunks: By position in the file.
        index: (N, 4) log time, position of the chunk, offset in it, and connection id of every message; sorted.
    """

    channels: dict[int, Channel]
    chunks: dict[int, Chunk]
    index: I64


def load_chunk(stream: BinaryIO, position: int, chunk: Chunk, limits: LimitsConfig) -> bytes:
    """The records of the compressed chunk that begins at `position`.

    Raises:
        Exception: any that the decompressing libraries raise, if it is damaged.
    """
    if chunk.compression == "lz4" and not chunk.is_cut:
        record = read_record(stream, position, chunk.data_position + chunk.data_size)
        size = record.number(b"size") if record is not None and record.kind == CHUNK else chunk.data_size
        stream.seek(chunk.data_position)
        return unpack_lz4(read_bytes(stream, chunk.data_size), size, largest=limits.max_chunk_bytes)
    end = chunk.data_position + chunk.data_size
    unpacked = unpack(stream, chunk.data_position, end, chunk.compression, largest=limits.max_chunk_bytes)
    if not chunk.is_cut:
        check_complete(unpacked, chunk.compression)
    return unpacked.data


def check_complete(unpacked: Unpacked, compression: str) -> None:
    """Refuse data that lack their end.

    Raises:
        EOFError: the end is missing.
    """
    if not unpacked.complete:
        raise EOFError(f"its {compression} data end early")


def contents_of_index(path: Path) -> Contents:
    """What the index of the bag says.

    Raises:
        ValueError: the index and the chunks disagree.
        Exception: any that the rosbags library raises, if there is no index or the file is damaged.
    """
    with Reader(path) as reader:
        names = {decompress: name for name, decompress in decompressors.items()}
        channels = {
            connection.id: Channel(
                connection.topic,
                connection.msgtype,
                "ros1",
                connection.msgdef.data,
                "ros1msg",
                digest=connection.digest,
            )
            for connection in reader.connections
        }
        chunks = {
            position: Chunk(chunk.datapos, chunk.datasize, names[chunk.decompressor])
            for position, chunk in reader.chunks.items()
        }
        return Contents(channels, chunks, _index_of(reader))


def _index_of(reader: Reader) -> I64:
    parts = [
        np.column_stack([np.array(entries, np.int64), np.full(len(entries), id_, np.int64)])
        for id_, entries in reader.indexes.items()
        if entries
    ]
    reader.indexes.clear()  # takes eight times the memory of the arrays
    counted = sum(sum(chunk.connection_counts.values()) for chunk in reader.chunk_infos)
    indexed = sum(len(part) for part in parts)
    if indexed != counted:
        raise ValueError(f"the chunks hold {counted} messages, the index lists {indexed}")
    return by_time(np.concatenate(parts) if parts else np.zeros((0, 4), np.int64))


def by_time(index: I64) -> I64:
    """The rows of an index in the order of (log time, chunk, offset)."""
    return index[np.lexsort((index[:, 2], index[:, 1], index[:, 0]))]
