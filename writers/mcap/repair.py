"""A damaged recording's recovered messages as an intact MCAP file, neither decoded nor changed."""

from collections.abc import Iterable, Iterator, Mapping

from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.writers.mcap.output import mcap_file
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import REPAIRED
from lidcam.writers.outputs.transaction import OutputFile

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
    record; the losses are read after the last message.

    Returns:
        Number of messages.

    Raises:
        OutputError: the file cannot be written.
        RecordingError: raised by `messages`.
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
