"""The chunks of a ROS 1 bag, and the messages in them by their own records."""

from collections.abc import Collection, Iterable, Iterator
from typing import BinaryIO, NamedTuple

from rosbags.rosbag1.reader import read_bytes

from pipeline.core.settings.recording import LimitsConfig
from readers.files.decompress import Unpacked, unpack, unpack_lz4
from readers.files.rosbag1.index import Chunk
from readers.files.rosbag1.records import CHUNK, CONNECTION, MESSAGE, Record, find_record, read_record

__all__ = [
    "Comparison",
    "Entry",
    "Found",
    "check_complete",
    "compared",
    "has_right_length",
    "load_chunk",
    "message_at",
    "messages_of",
    "records_of",
]


class Entry(NamedTuple):
    """What the index says of a message.

    Attributes:
        log_time_ns: Time of recording.
        offset: First byte of its record, from the beginning of the chunk's data.
        connection_id: Its connection.
    """

    log_time_ns: int
    offset: int
    connection_id: int


class Found(NamedTuple):
    """A message in a chunk.

    Attributes:
        entry: What the index has to say of it.
        first_offset: As the offset, where records of connections stand directly before it: some writers index these.
        data_at: First byte of its data, from the beginning of the stream that was read.
        size: Bytes of its data.
    """

    entry: Entry
    first_offset: int
    data_at: int
    size: int


class Comparison(NamedTuple):
    """The index of a chunk and the chunk itself.

    Attributes:
        agreed: What both name.
        only_indexed: Entries for which the chunk has no such message.
        unlisted: Messages for which the index has no such entry.
    """

    agreed: list[Found]
    only_indexed: list[Entry]
    unlisted: list[Found]


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


def records_of(stream: BinaryIO, begin: int, end: int) -> Iterator[Record]:
    """The messages and connections of a chunk; damage is passed over."""
    position, record = begin, read_record(stream, begin, end)
    while position < end:
        following = None if record is None else read_record(stream, record.end, end)
        if (
            record is None
            or record.kind not in {MESSAGE, CONNECTION}
            or (following is None and record.end != end)  # its length is wrong
        ):
            position = find_record(stream, position + 1 if record is None else record.data, end)
            record = read_record(stream, position, end)
            continue
        yield record
        position, record = record.end, following


def messages_of(stream: BinaryIO, begin: int, end: int, limits: LimitsConfig) -> tuple[list[Found], list[Record]]:
    """The messages of a chunk, and its records of connections.

    Raises:
        ValueError: there are too many.
    """
    found: list[Found] = []
    connections: list[Record] = []
    first: int | None = None
    for record in records_of(stream, begin, end):
        first = record.start if first is None else first
        if record.kind == CONNECTION:
            connections.append(record)
            continue
        found.append(_found(record, first, begin))
        first = None
        if len(found) > limits.max_messages_per_chunk:
            raise ValueError(
                f"a chunk of more than {limits.max_messages_per_chunk} messages, see limits.max_messages_per_chunk"
            )
    return found, connections


def message_at(stream: BinaryIO, position: int, begin: int, end: int) -> Found | None:
    """The message whose record, or that of a connection before it, is at `position`; None if there is none."""
    record = read_record(stream, position, end)
    while record is not None and record.kind == CONNECTION:
        record = read_record(stream, record.end, end)
    if record is None or record.kind != MESSAGE:
        return None
    return _found(record, position, begin)


def has_right_length(stream: BinaryIO, message: Found, end: int) -> bool:
    """Whether a message ends with its chunk, or another record begins behind it."""
    behind = message.data_at + message.size
    return behind == end or read_record(stream, behind, end) is not None


def compared(entries: Iterable[Entry], found: Collection[Found]) -> Comparison:
    """What the index of a chunk and its own records have in common."""
    by_offset = {message.first_offset: message for message in found}
    by_offset |= {message.entry.offset: message for message in found}
    agreed: dict[int, Found] = {}
    only_indexed: list[Entry] = []
    for entry in entries:
        message = by_offset.get(entry.offset)
        if message is None or not _agrees(message, entry) or message.data_at in agreed:
            only_indexed.append(entry)
        else:
            agreed[message.data_at] = message._replace(entry=entry)
    unlisted = [message for message in found if message.data_at not in agreed]
    return Comparison([*agreed.values()], only_indexed, unlisted)


def _agrees(message: Found, entry: Entry) -> bool:
    own = message.entry
    return (own.log_time_ns, own.connection_id) == (entry.log_time_ns, entry.connection_id)


def _found(record: Record, first: int, begin: int) -> Found:
    entry = Entry(record.time_ns, record.start - begin, record.number(b"conn"))
    return Found(entry, first - begin, record.data, record.size)
