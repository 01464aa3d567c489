"""What was saved of a recording, as one clean MCAP: the messages as they were recorded, not decoded and not changed."""

import base64
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer

from pipeline.core.messages import Channel, RawMessage
from writers.atomic import atomic_output, output_errors

__all__ = ["write_repaired"]

LIBRARY = "lidcam"
CHUNK_BYTES = 1 << 20

METADATA = "lidcam.repair"
"""Name of the metadata record that says what was lost."""

PROFILES = {frozenset({"ros1"}): "ros1", frozenset({"cdr"}): "ros2"}


def write_repaired(
    path: Path, channels: Iterable[Channel], messages: Iterator[RawMessage], *, lost: Iterable[Mapping[str, str]]
) -> int:
    """Write messages to a new MCAP file, in their order, with their log times.

    Args:
        path: The file to write; it appears when it is whole.
        channels: All channels, in the order in which they are listed; also those without messages.
        messages: The messages.
        lost: What could not be saved, record by record, for the file's metadata; asked for after the last message.

    Returns:
        Number of messages.

    Raises:
        OutputError: the file cannot be written.
        RecordingError: of the messages.
    """
    channels = list(dict.fromkeys(channels))
    profile = PROFILES.get(frozenset(channel.encoding for channel in channels), "")
    count = 0
    with atomic_output(path) as part, output_errors(path), part.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile=profile, library=LIBRARY)
        schemas: dict[tuple[str, str, bytes], int] = {}
        ids = {channel: _register(writer, channel, schemas) for channel in channels}
        for message in messages:
            if message.channel not in ids:
                ids[message.channel] = _register(writer, message.channel, schemas)
            writer.add_message(
                ids[message.channel], message.log_time_ns, bytes(message.data), message.log_time_ns, count
            )
            count += 1
        for record in lost:
            writer.add_metadata(METADATA, dict(record))
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part
    return count


def _register(writer: Writer, channel: Channel, schemas: dict[tuple[str, str, bytes], int]) -> int:
    schema = _schema(channel)
    if schema not in schemas:
        schemas[schema] = writer.register_schema(*schema)
    metadata = {}
    if channel.digest:
        metadata["md5sum" if channel.encoding == "ros1" else "topic_type_hash"] = channel.digest
    if channel.encoding == "cdr":
        metadata["offered_qos_profiles"] = ""
    return writer.register_channel(channel.topic, channel.encoding, schemas[schema], metadata)


def _schema(channel: Channel) -> tuple[str, str, bytes]:
    """Name, encoding and data of the schema (mcap.dev/spec/registry)."""
    name, definition_format = channel.msgtype, str(channel.definition_format)
    if channel.encoding == "ros1":
        return name.replace("/msg/", "/"), definition_format, channel.definition.encode()
    if channel.encoding == "protobuf":
        return name, definition_format, base64.b64decode(channel.definition)
    if not channel.definition:
        definition_format = ""  # as rosbag2 writes a type of which it knows the name only
    return name, definition_format, channel.definition.encode()
