"""A recording as the rest of lidcam reads it: one topic per sensor, with one ROS message per measurement.

Combined messages are taken apart (see `unpack`) and Foxglove's schemas become ROS types (see `foxglove`), message by
message, on the topics that are asked for. All other messages pass as they are.
"""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from pipeline.types import Channel, RawMessage
from readers.base import Closing, Loss, Recording, TopicInfo, merge_topics
from readers.foxglove import ros_channel, to_ros
from readers.unpack import Parts, find_combined, split

__all__ = ["sensor_messages"]


def sensor_messages(recording: Recording) -> Recording:
    """The recording with a topic of its own, and a ROS type, for every sensor; closed together with it.

    Raises:
        RecordingError: the recording cannot be read; it is closed then.
    """
    try:
        combined = find_combined(recording)
    except BaseException:
        recording.close()
        raise
    channels = {channel for info in recording.topics for channel in info.channels}
    foreign = {channel for channel in channels if channel.encoding in {"protobuf", "json"}}
    return _SensorMessages(recording, combined, foreign) if combined or foreign else recording


class _SensorMessages(Closing):
    """See `Recording`."""

    def __init__(self, recording: Recording, combined: dict[Channel, Parts], foreign: Collection[Channel]) -> None:
        self._recording = recording
        self._combined = combined
        self._foreign = foreign
        self.topics = merge_topics(self._infos(recording.topics))
        self._whole = {info.topic: info.part_of for info in self.topics if info.part_of}

    @property
    def paths(self) -> tuple[Path, ...]:
        """See `Recording`."""
        return self._recording.paths

    @property
    def start_ns(self) -> int:
        """See `Recording`."""
        return self._recording.start_ns

    @property
    def end_ns(self) -> int:
        """See `Recording`."""
        return self._recording.end_ns

    @property
    def message_count(self) -> int:
        """See `Recording`; a combined message counts once."""
        return self._recording.message_count

    @property
    def losses(self) -> tuple[Loss, ...]:
        """See `Recording`."""
        return self._recording.losses

    def messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See `Recording`."""
        wanted = frozenset([info.topic for info in self.topics] if topics is None else topics)
        recorded = None if topics is None else {self._whole.get(topic, topic) for topic in topics}
        for message in self._recording.messages(recorded, start_ns=start_ns, stop_ns=stop_ns):
            if message.channel in self._combined:
                yield from split(message, self._combined[message.channel], wanted)
            elif message.topic not in wanted:  # of a combined message's topic, but of another type
                continue
            else:
                yield to_ros(message) if message.channel in self._foreign else message

    def close(self) -> None:
        """Close the recording."""
        self._recording.close()

    def _infos(self, recorded: Iterable[TopicInfo]) -> Iterator[TopicInfo]:
        for info in recorded:
            parts: dict[tuple[str, str], dict[Channel, None]] = {}
            kept: list[Channel] = []
            for channel in info.channels:
                if channel not in self._combined:
                    kept.append(ros_channel(channel) if channel in self._foreign else channel)
                for part in self._combined.get(channel, {}).values():
                    parts.setdefault((part.topic, part.msgtype), {})[part] = None
            for (topic, msgtype), channels in parts.items():
                yield TopicInfo(topic, msgtype, info.message_count, tuple(channels), part_of=info.topic)
            if kept:
                yield replace(info, msgtype=kept[0].msgtype, channels=tuple(kept))
            elif not parts:
                yield info
