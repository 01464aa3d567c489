"""A recording with one topic per sensor and one ROS message per measurement.

Combined messages are split (see `combined_messages`), Foxglove's schemas become ROS types (see `foxglove`), and packets
of Velodynes become sweeps (see `sweeps`). All other messages pass unchanged. Video is decoded later (see `video`);
without PyAV its topics cannot be read.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace

from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.foxglove import ROS_TYPES, ros_channel, to_ros
from lidcam.readers.recording import Closing, Loss, Recording, TopicInfo, merge_topics
from lidcam.readers.streams.combined_messages import Parts, find_combined, split
from lidcam.readers.velodyne.scan import PACKET, SCAN, packet_problem, scan_channel
from lidcam.readers.velodyne.sweeps import PAUSE_NS, gather_sweeps
from lidcam.readers.video.packets import VIDEO, missing_decoder


def sensor_messages(recording: Recording, *, limits: RecordingLimits = DEFAULT_LIMITS) -> Recording:
    """The recording with one topic and a ROS type for every sensor; closing it closes `recording`.

    Raises:
        RecordingError: the recording cannot be read; it is then closed.
    """
    try:
        combined = find_combined(recording, limits=limits)
    except BaseException:
        recording.close()
        raise
    adapted = _SensorMessages(recording, combined, limits)
    return adapted if adapted.changes_anything else recording


def _problem(channel: Channel) -> str:
    """Why the messages of a channel cannot be used; empty if they can."""
    if channel.msgtype == PACKET:
        return packet_problem(channel)
    return missing_decoder() if ROS_TYPES.get(channel.msgtype, channel.msgtype) in VIDEO else ""


class _SensorMessages(Closing):
    """See `Recording`; `message_count` counts a combined message once."""

    def __init__(self, recording: Recording, combined: Mapping[Channel, Parts], limits: RecordingLimits) -> None:
        channels = {channel for info in recording.topics for channel in info.channels}
        packets = {channel for channel in channels if channel.msgtype == PACKET}
        self._recording = recording
        self._combined = combined
        self._limits = limits
        self._foreign = {channel for channel in channels if channel.encoding in {"protobuf", "json"}}
        self._closed = {channel: problem for channel in channels if (problem := _problem(channel))}
        self._packets = packets - self._closed.keys()
        self.changes_anything = bool(combined or self._foreign or self._closed or packets)
        self.paths, self.opened = recording.paths, recording.opened
        self.start_ns, self.end_ns, self.message_count = recording.start_ns, recording.end_ns, recording.message_count
        self.topics = merge_topics(self._infos(recording.topics))
        self._whole = {info.topic: info.part_of for info in self.topics if info.part_of}

    @property
    def losses(self) -> tuple[Loss, ...]:
        """See `Recording`."""
        return self._recording.losses

    def messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See `Recording`."""
        wanted = frozenset([info.topic for info in self.topics] if topics is None else topics)
        if not any(channel.topic in wanted for channel in self._packets):
            return self._sensor_messages(topics, wanted, start_ns, stop_ns)
        around = self._sensor_messages(
            topics,
            wanted,
            None if start_ns is None else start_ns - PAUSE_NS,
            None if stop_ns is None else stop_ns + PAUSE_NS,
        )
        return gather_sweeps(around, self._packets, start_ns=start_ns, stop_ns=stop_ns)

    def _sensor_messages(
        self, topics: Collection[str] | None, wanted: Collection[str], start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """The messages, with packets as recorded."""
        recorded = None if topics is None else {self._whole.get(topic, topic) for topic in topics}
        for message in self._recording.messages(recorded, start_ns=start_ns, stop_ns=stop_ns):
            if message.channel in self._combined:
                yield from split(message, self._combined[message.channel], wanted, limits=self._limits)
            elif message.channel not in self._closed and message.topic in wanted:  # a topic may be read for its parts
                yield to_ros(message, limits=self._limits) if message.channel in self._foreign else message

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
            problem = next((self._closed[channel] for channel in info.channels if channel in self._closed), "")
            if info.msgtype == PACKET and info.channels:
                scans = () if problem else (scan_channel(info.topic),)
                yield replace(info, msgtype=SCAN, channels=scans, unreadable=problem, gathered_from=PACKET)
            elif problem:
                yield replace(info, msgtype=kept[0].msgtype, channels=(), unreadable=problem)
            elif kept:
                yield replace(info, msgtype=kept[0].msgtype, channels=tuple(kept))
            elif not parts:
                yield info
