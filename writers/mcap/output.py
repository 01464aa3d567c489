"""One MCAP file that is being written (mcap.dev/spec): schemas, channels, chunks of messages, and a summary at its end.

The `mcap` library encodes what is small. Messages are put together here, so that clouds and images are not copied on
their way, and chunks are compressed and written on a thread beside the run.
"""

import base64
import contextlib
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.records import Channel as ChannelRecord
from mcap.writer import MCAP0_MAGIC

from lidcam.pipeline.core.messages import Channel
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.parallel.background import Background
from lidcam.writers.mcap.chunk import Buffer, Chunk, Compression, compressor
from lidcam.writers.outputs.marks import LIBRARY

CHUNK_BYTES = 1 << 20
"""An image or cloud is about one chunk: a viewer that shows one topic unpacks little else."""

WAITING_BYTES = 1 << 24
"""Chunks that may wait to be compressed and written."""

_SUMMARY = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
"""Groups of the summary, in their order."""


class MessageSink(ABC):
    """Takes channels and their messages: a file, or a server."""

    @abstractmethod
    def add_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes], metadata: Mapping[str, str] | None = None
    ) -> int:
        """The id of a new channel; `schema` is name, encoding and data (mcap.dev/spec/registry)."""

    @abstractmethod
    def add_message(self, channel: int, log_time_ns: int, data: Buffer | Sequence[Buffer], sequence: int = 0) -> None:
        """Add a message, published when it was logged; its bytes, or parts of them, must not change any more."""

    def add_ros2(self, topic: str, msgtype: str, qos: str | None = "") -> int:
        """The id of a new channel for CDR messages of lidcam's own, whose publisher offers this quality of service."""
        schema = msgtype, "ros2msg", ROS2.definition(msgtype).encode()
        return self.add_channel(topic, "cdr", schema, {} if qos is None else {"offered_qos_profiles": qos})

    def add_recorded(self, channel: Channel, topic: str = "") -> int:
        """The id of a new channel for messages as they were recorded, under another topic if one is given."""
        metadata = {}
        if channel.digest:
            metadata["md5sum" if channel.encoding == "ros1" else "topic_type_hash"] = channel.digest
        if channel.encoding == "cdr":
            metadata["offered_qos_profiles"] = ""
        return self.add_channel(topic or channel.topic, channel.encoding, _schema(channel), metadata)


class McapOutput(MessageSink):
    """An open MCAP file; `mcap_file` opens one.

    Errors of the thread that writes are raised by the next call.
    """

    def __init__(self, stream: BinaryIO, background: Background, profile: str, compression: Compression) -> None:
        self._stream, self._background = stream, background
        self._compression, self._compress = compression, compressor(compression)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._chunk = Chunk()
        self._summary = {opcode: RecordBuilder() for opcode in _SUMMARY}
        self._statistics = Statistics(
            attachment_count=0,
            channel_count=0,
            channel_message_counts={},
            chunk_count=0,
            message_count=0,
            message_end_time=0,
            message_start_time=0,
            metadata_count=0,
            schema_count=0,
        )
        stream.write(MCAP0_MAGIC + _encoded(Header(profile, LIBRARY)))

    def add_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes], metadata: Mapping[str, str] | None = None
    ) -> int:
        """As of `MessageSink`; a schema is written once."""
        counts = self._statistics
        if schema not in self._schemas:
            counts.schema_count += 1
            name, schema_encoding, data = schema
            self._schemas[schema] = counts.schema_count
            self._define(Opcode.SCHEMA, Schema(counts.schema_count, data, schema_encoding, name))
        counts.channel_count += 1
        record = ChannelRecord(counts.channel_count, topic, encoding, dict(metadata or {}), self._schemas[schema])
        self._define(Opcode.CHANNEL, record)
        return counts.channel_count

    def add_message(self, channel: int, log_time_ns: int, data: Buffer | Sequence[Buffer], sequence: int = 0) -> None:
        """As of `MessageSink`."""
        parts = (data,) if isinstance(data, bytes | memoryview) else data
        self._chunk.add_message(channel, sequence, log_time_ns, parts)
        self._end_full_chunk()

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add a metadata record."""
        start, length = self._put(Metadata(metadata=dict(record), name=name))
        self._statistics.metadata_count += 1
        MetadataIndex(start, length, name).write(self._summary[Opcode.METADATA_INDEX])

    def attach(self, name: str, text: str, time_ns: int = 0, media_type: str = "application/yaml") -> None:
        """Attach a text file."""
        data = text.encode()
        start, length = self._put(Attachment(time_ns, time_ns, name, media_type, data))
        self._statistics.attachment_count += 1
        index = AttachmentIndex(start, length, time_ns, time_ns, len(data), name, media_type)
        index.write(self._summary[Opcode.ATTACHMENT_INDEX])

    def finish(self) -> None:
        """Write what is left, and the summary.

        Raises:
            OSError: it cannot be written.
        """
        self._end_chunk()
        self._put(DataEnd(0))
        self._statistics.write(self._summary[Opcode.STATISTICS])
        start = place = self._stream.tell()
        summary, offsets = [], []
        for opcode, builder in self._summary.items():
            records = _end(builder)
            summary.append(records)
            offsets.append(_encoded(SummaryOffset(opcode, place, len(records))))
            place += len(records)
        footer = Footer(summary_start=start, summary_offset_start=place, summary_crc=0)
        whole = b"".join((*summary, *offsets))
        footer.summary_crc = zlib.crc32(_encoded(footer)[:-4], zlib.crc32(whole))
        self._stream.write(b"".join((whole, _encoded(footer), MCAP0_MAGIC)))

    def _define(self, opcode: Opcode, record: McapRecord) -> None:
        """Add a schema or a channel, to the chunk and to the summary."""
        encoded = _encoded(record)
        self._summary[opcode].write(encoded)
        self._chunk.add_record(encoded)
        self._end_full_chunk()

    def _put(self, record: McapRecord) -> tuple[int, int]:
        """Write a record outside of chunks, behind those that are complete; its place and its length."""
        self._background.finish()
        start, encoded = self._stream.tell(), _encoded(record)
        self._stream.write(encoded)
        return start, len(encoded)

    def _end_full_chunk(self) -> None:
        if self._chunk.size > CHUNK_BYTES:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Hand the chunk over to be compressed and written, unless it has only definitions: the summary has them."""
        chunk = self._chunk
        if chunk.has_messages:
            self._chunk = Chunk()
            self._count(chunk)
            self._background.add(lambda: self._write(chunk), chunk.size)

    def _count(self, chunk: Chunk) -> None:
        counts, (start_ns, end_ns) = self._statistics, chunk.span_ns
        counts.message_start_time = min(start_ns, counts.message_start_time) if counts.chunk_count else start_ns
        counts.message_end_time = max(end_ns, counts.message_end_time)
        counts.chunk_count += 1
        for channel, count in chunk.counts.items():
            counts.channel_message_counts[channel] = counts.channel_message_counts.get(channel, 0) + count
            counts.message_count += count

    def _write(self, chunk: Chunk) -> None:
        """On the other thread."""
        index = chunk.write(self._stream, self._compress, self._compression)
        index.write(self._summary[Opcode.CHUNK_INDEX])


@contextlib.contextmanager
def mcap_file(path: Path, *, profile: str, compression: Compression = "zstd") -> Iterator[McapOutput]:
    """Open a new file, which is complete when the block ends well; `output_errors` may enclose the block.

    Raises:
        OSError: it cannot be written.
    """
    with path.open("xb") as stream, contextlib.closing(Background(WAITING_BYTES, "lidcam-write")) as background:
        file = McapOutput(stream, background, profile, compression)
        yield file
        file.finish()


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return _end(builder)


def _end(builder: RecordBuilder) -> bytes:
    encoded: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap annotates in part
    return encoded


def _schema(channel: Channel) -> tuple[str, str, bytes]:
    """Name, encoding and data of the schema (mcap.dev/spec/registry)."""
    name, definition_format = channel.msgtype, str(channel.definition_format)
    if channel.encoding == "ros1":
        return name.replace("/msg/", "/"), definition_format, channel.definition.encode()
    if channel.encoding == "protobuf":
        return name, definition_format, base64.b64decode(channel.definition)
    if not channel.definition:
        definition_format = ""  # as rosbag2 writes a type whose definition it does not know
    return name, definition_format, channel.definition.encode()
