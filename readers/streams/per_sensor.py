"""A recording with one topic per sensor and one ROS message per measurement.

Combined messages, of any type with a list of images or clouds among its fields, are split, whatever the type's name:
each part becomes a message with its own stamp. The predecessor system recorded msgs/MsgCamera (`sensor_msgs/Image[]
camera`) and msgs/ListPointCloud (`sensor_msgs/PointCloud2[] pointcloud`). Part `n` (from 1) of field `camera` of
`/camera_msgs_combined` has the topic `/camera_msgs_combined/camera_n`: the index in the list identifies the sensor.

Foxglove's schemas become ROS types (see `foxglove`), and packets of Velodynes and Ousters become sweeps (see `sweeps`).
CompressedImage that holds packets of a video becomes CompressedVideo. All other messages pass unchanged. Video is
decoded later (see `video`); without PyAV its topics cannot be read.
"""

import re
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import islice

from rosbags.interfaces import Nodetype

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize, typestore_for
from lidcam.readers.messages.foxglove import ROS_TYPES, ros_channel, to_ros
from lidcam.readers.messages.header_stamp import stamp_or_log_time
from lidcam.readers.messages.image import COMPRESSED_IMAGE
from lidcam.readers.ouster import packets as ouster
from lidcam.readers.ouster.description import find_description
from lidcam.readers.ouster.sensor import missing_sdk
from lidcam.readers.ouster.sweeps import OusterSweep
from lidcam.readers.recording import Closing, Loss, Recording, TopicInfo, merge_topics
from lidcam.readers.sweeps import PAUSE_NS, Sweep, gather_sweeps
from lidcam.readers.velodyne.scan import PACKET, PACKET_FIELDS, scan_channel
from lidcam.readers.velodyne.sweeps import VelodyneSweep
from lidcam.readers.video.packets import VIDEO, as_video, is_video_image, missing_decoder, video_channel

PART_TYPES = frozenset({"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2"})

LISTS = re.compile(r"(?:Image|PointCloud2)\s*[\[,>]")
"""Lists in .msg (`Image[]`) and in IDL (`sequence<Image>`); saves parsing most definitions."""

PROBED = 5
"""Messages that are read to count their parts: a sensor may be missing from the first."""

MAX_PARTS = 64
"""Sensors in one list: the length of a damaged list can be any number."""

Parts = Mapping[tuple[str, int], Channel]
"""Channel of each part, by (field, index from 0)."""


def find_combined(recording: Recording, *, limits: RecordingLimits = DEFAULT_LIMITS) -> dict[Channel, Parts]:
    """Channels of combined messages, with the parts found in their first messages."""
    channels = [channel for info in recording.topics if info.message_count for channel in info.channels]
    lists = {channel: fields for channel in channels if (fields := _lists(channel))}
    found = {channel: _parts(channel, fields, recording, limits) for channel, fields in lists.items()}
    return {channel: parts for channel, parts in found.items() if parts}


def split(
    message: RawMessage, parts: Parts, wanted: Container[str], *, limits: RecordingLimits = DEFAULT_LIMITS
) -> Iterator[RawMessage]:
    """The parts of a message on the topics `wanted`, in the order of its fields and lists, with its log time.

    A message that cannot be decoded becomes one message with that problem on each topic. A part that none of the first
    messages had is skipped: it has no topic.
    """
    try:
        yield from _split(message, parts, wanted, limits)
    except MessageError as err:
        for place, channel in enumerate(parts.values()):
            if channel.topic in wanted:
                order = (*message.order, place)
                yield message._replace(order=order, data=b"", channel=channel, problem=str(err))


@decoder
def _split(message: RawMessage, parts: Parts, wanted: Container[str], limits: RecordingLimits) -> list[RawMessage]:
    whole, store = deserialize(message, limits=limits), typestore_for(message.channel)
    serialize = store.serialize_ros1 if message.channel.encoding == "ros1" else store.serialize_cdr
    found = []
    for place, ((name, index), channel) in enumerate(parts.items()):
        if channel.topic in wanted and index < len(items := getattr(whole, name)):
            data = serialize(items[index], channel.msgtype)
            stamp_ns = stamp_or_log_time(channel, data, message.log_time_ns)
            found.append(RawMessage(stamp_ns, message.log_time_ns, (*message.order, place), data, channel))
    return found


def _lists(channel: Channel) -> dict[str, str]:
    """Type of the parts by field, for fields that are lists of images or clouds."""
    if channel.encoding not in {"ros1", "cdr"}:
        return {}
    if channel.definition and not LISTS.search(channel.definition):
        return {}
    try:
        fields = typestore_for(channel).fielddefs[channel.msgtype][1]
    except MessageError:  # reported where the topic is used
        return {}
    lists = {name: detail[0] for name, (node, detail) in fields if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}}
    return {name: str(item[1]) for name, item in lists.items() if item[0] == Nodetype.NAME and item[1] in PART_TYPES}


def _parts(channel: Channel, fields: dict[str, str], recording: Recording, limits: RecordingLimits) -> Parts:
    counts = dict.fromkeys(fields, 0)
    same = (message for message in recording.messages([channel.topic]) if message.channel == channel)
    for message in islice(same, PROBED):
        try:
            whole = deserialize(message, limits=limits)
        except MessageError:
            continue
        counts = {name: max(count, len(getattr(whole, name))) for name, count in counts.items()}
    store = typestore_for(channel)
    ros1 = channel.encoding == "ros1"
    parts = {}
    for name, msgtype in fields.items():
        text, _ = store.generate_msgdef(msgtype, ros_version=1 if ros1 else 2)
        for index in range(min(counts[name], MAX_PARTS)):
            topic = f"{channel.topic}/{name}_{index + 1}"
            parts[name, index] = Channel(topic, msgtype, channel.encoding, text, "ros1msg" if ros1 else "ros2msg")
    return parts


def sensor_messages(recording: Recording, *, limits: RecordingLimits = DEFAULT_LIMITS) -> Recording:
    """The recording with one topic and a ROS type for every sensor; closing it closes `recording`.

    Raises:
        RecordingError: the recording cannot be read; it is then closed.
    """
    try:
        adapted = _SensorMessages(recording, find_combined(recording, limits=limits), limits)
    except BaseException:
        recording.close()
        raise
    return adapted if adapted.changes_anything else recording


def _problem(channel: Channel) -> str:
    """Why the messages of a channel cannot be used; empty if they can."""
    if channel.msgtype == PACKET:
        return _layout_problem(channel, PACKET_FIELDS, "a stamp and uint8[1206]")
    if ouster.is_lidar_packets(channel):
        return missing_sdk() or _layout_problem(channel, ouster.FIELDS, "uint8[] buf")
    return missing_decoder() if ROS_TYPES.get(channel.msgtype, channel.msgtype) in VIDEO else ""


def _layout_problem(channel: Channel, known: object, words: str) -> str:
    """Why packets whose bytes are read in place cannot be used: their definition is another one."""
    try:
        fields = typestore_for(channel).fielddefs[channel.msgtype][1]
    except MessageError as err:
        return str(err).removeprefix(f"{channel.topic}: ")
    return "" if fields == known else f"its definition of {channel.msgtype} is not {words}"


def gathered_channel(info: TopicInfo) -> Channel | None:
    """The channel of the sweeps of a topic's packets; None if it has none."""
    if info.msgtype == PACKET and info.channels:
        return scan_channel(info.topic)
    is_ouster = any(ouster.is_lidar_packets(channel) for channel in info.channels)
    return ouster.sweep_channel(info.topic) if is_ouster else None


class _SensorMessages(Closing):
    """See `Recording`; `message_count` counts a combined message once."""

    def __init__(self, recording: Recording, combined: Mapping[Channel, Parts], limits: RecordingLimits) -> None:
        channels = {channel for info in recording.topics for channel in info.channels}
        self._recording = recording
        self._combined = combined
        self._limits = limits
        self._foreign = {channel for channel in channels if channel.encoding in {"protobuf", "json"}}
        self._closed = {channel: problem for channel in channels if (problem := _problem(channel))}
        self._packets = self._sweeps(channels - self._closed.keys())
        compressed = {channel for channel in channels if channel.msgtype == COMPRESSED_IMAGE}
        first = [one for topic in {c.topic for c in compressed} for one in islice(recording.messages([topic]), 1)]
        filmed = {message.topic for message in first if is_video_image(message)}
        self._filmed = {channel for channel in compressed if channel.topic in filmed}
        self._closed |= dict.fromkeys(self._filmed, problem) if (problem := missing_decoder()) else {}
        self.changes_anything = bool(combined or self._foreign or self._closed or self._packets or self._filmed)
        self.paths, self.opened = recording.paths, recording.opened
        self.start_ns, self.end_ns, self.message_count = recording.start_ns, recording.end_ns, recording.message_count
        self.topics = merge_topics(self._infos(recording.topics))
        self._whole = {info.topic: info.part_of for info in self.topics if info.part_of}

    @property
    def losses(self) -> tuple[Loss, ...]:
        return self._recording.losses

    def messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
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
                if message.channel in self._foreign:
                    yield to_ros(message, limits=self._limits)
                else:
                    yield as_video(message) if message.channel in self._filmed else message

    def close(self) -> None:
        self._recording.close()

    def _sweeps(self, channels: Collection[Channel]) -> dict[Channel, Callable[[str], Sweep]]:
        """The collectors of the packets of channels; channels that cannot be collected are closed."""
        found: dict[Channel, Callable[[str], Sweep]] = {one: VelodyneSweep for one in channels if one.msgtype == PACKET}
        ousters = sorted((one for one in channels if ouster.is_lidar_packets(one)), key=lambda one: one.topic)
        single = len({channel.topic for channel in ousters}) == 1
        for channel in ousters:
            try:
                text = find_description(self._recording, channel.topic)
            except MessageError as err:
                self._closed[channel] = str(err).removeprefix(f"{channel.topic}: ")
                continue
            frame = ouster.FRAME if single else f"{channel.topic.strip('/').split('/')[0]}/{ouster.FRAME}"
            found[channel] = partial(OusterSweep, frame_id=frame, metadata=text)
        return found

    def _ros_channel(self, channel: Channel) -> Channel:
        if channel in self._foreign:
            return ros_channel(channel)
        return video_channel(channel) if channel in self._filmed else channel

    def _infos(self, recorded: Iterable[TopicInfo]) -> Iterator[TopicInfo]:
        for info in recorded:
            parts: dict[tuple[str, str], dict[Channel, None]] = {}
            kept: list[Channel] = []
            for channel in info.channels:
                if channel not in self._combined:
                    kept.append(self._ros_channel(channel))
                for part in self._combined.get(channel, {}).values():
                    parts.setdefault((part.topic, part.msgtype), {})[part] = None
            for (topic, msgtype), channels in parts.items():
                yield TopicInfo(topic, msgtype, info.message_count, tuple(channels), part_of=info.topic)
            problem = next((self._closed[channel] for channel in info.channels if channel in self._closed), "")
            if (gathered := gathered_channel(info)) is not None:
                sweeps = () if problem else (gathered,)
                yield replace(
                    info, msgtype=gathered.msgtype, channels=sweeps, unreadable=problem, gathered_from=info.msgtype
                )
            elif problem:
                yield replace(info, msgtype=kept[0].msgtype, channels=(), unreadable=problem)
            elif kept:
                yield replace(info, msgtype=kept[0].msgtype, channels=tuple(kept))
            elif not parts:
                yield info
