"""MCAP files that are written (mcap.dev/spec): results, and the recovered messages of damaged recordings."""

import base64
import contextlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Literal

from mcap.writer import CompressionType, Writer

from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import LIBRARY, REPAIRED
from lidcam.writers.outputs.transaction import OutputFile

Buffer = bytes | memoryview

CHUNK_BYTES = 1 << 20
"""An image or cloud is about one chunk: a viewer that shows one topic unpacks little else."""


class MessageSink(ABC):
    """Takes channels and their messages: a file, or a server."""

    @abstractmethod
    def add_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes], metadata: Mapping[str, str]
    ) -> int:
        """The id of a new channel; `schema` is name, encoding and data (mcap.dev/spec/registry)."""

    @abstractmethod
    def add_message(self, channel: int, log_time_ns: int, data: Buffer, sequence: int = 0) -> None:
        """Add a message, published when it was logged."""

    def add_ros2(self, topic: str, msgtype: str, qos: str | None = "") -> int:
        """The id of a new channel for CDR messages of lidcam's own, whose publisher offers this quality of service."""
        schema = msgtype, "ros2msg", ROS2.definition(msgtype).encode()
        return self.add_channel(topic, "cdr", schema, {} if qos is None else {"offered_qos_profiles": qos})

    def add_recorded(self, channel: Channel) -> int:
        """The id of a new channel for messages as they were recorded."""
        metadata = {}
        if channel.digest:
            metadata["md5sum" if channel.encoding == "ros1" else "topic_type_hash"] = channel.digest
        if channel.encoding == "cdr":
            metadata["offered_qos_profiles"] = ""
        return self.add_channel(channel.topic, channel.encoding, _schema(channel), metadata)


class McapOutput(MessageSink):
    """An open MCAP file; `mcap_file` opens one."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[tuple[str, str, bytes], int] = {}

    def add_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes], metadata: Mapping[str, str]
    ) -> int:
        """As of `MessageSink`; a schema is written once."""
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(*schema)
        return self._writer.register_channel(topic, encoding, self._schemas[schema], dict(metadata))

    def add_message(self, channel: int, log_time_ns: int, data: Buffer, sequence: int = 0) -> None:
        """As of `MessageSink`."""
        self._writer.add_message(channel, log_time_ns, data, log_time_ns, sequence)  # type: ignore[arg-type]  # a view will do

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(record))

    def attach(self, name: str, text: str, time_ns: int = 0, media_type: str = "application/yaml") -> None:
        """Attach a text file."""
        self._writer.add_attachment(time_ns, time_ns, name, media_type, text.encode())


@contextlib.contextmanager
def mcap_file(
    path: Path, *, profile: str, compression: Literal["none", "lz4", "zstd"] = "zstd"
) -> Iterator[McapOutput]:
    """Open a new file, which is complete when the block ends well; `output_errors` may enclose the block."""
    with path.open("xb") as stream:
        writer = Writer(stream, CHUNK_BYTES, CompressionType[compression.upper()])
        writer.start(profile, LIBRARY)
        yield McapOutput(writer)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part


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


PROFILES = {frozenset({"ros1"}): "ros1", frozenset({"cdr"}): "ros2"}


def write_repaired(
    output: OutputFile,
    channels: Iterable[Channel],
    messages: Iterator[RawMessage],
    *,
    lost: Iterable[Mapping[str, str]],
) -> int:
    """Write messages to a new MCAP file, in their order, with their log times.

    The channels are those of the file's list, in its order, also those without messages. Each loss becomes a metadata
    record; the losses are read after the last message. Returns the number of messages.
    """
    channels = list(dict.fromkeys(channels))
    profile = PROFILES.get(frozenset(channel.encoding for channel in channels), "")
    count = 0
    with output_errors(output.path), mcap_file(output.part, profile=profile) as file:
        ids = {channel: file.add_recorded(channel) for channel in channels}
        for message in messages:
            if message.channel not in ids:
                ids[message.channel] = file.add_recorded(message.channel)
            file.add_message(ids[message.channel], message.log_time_ns, message.data, count)
            count += 1
        losses = list(lost)
        file.add_metadata(REPAIRED, {"messages": str(count), "losses": str(len(losses))})
        for record in losses:
            file.add_metadata(REPAIRED, record)
    return count
