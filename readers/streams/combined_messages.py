"""Splits messages that hold several images or clouds: each part becomes a message with its own stamp.

Any type with a list of images or clouds among its fields is split, whatever its name. The predecessor system recorded
msgs/MsgCamera (`sensor_msgs/Image[] camera`) and msgs/ListPointCloud (`sensor_msgs/PointCloud2[] pointcloud`). Part `n`
(from 1) of field `camera` of `/camera_msgs_combined` has the topic `/camera_msgs_combined/camera_n`: the index in the
list identifies the sensor.
"""

import re
from collections.abc import Container, Iterator, Mapping
from itertools import islice

from rosbags.interfaces import Nodetype

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.boundary.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize, typestore_for
from lidcam.readers.messages.header_stamp import stamp_or_log_time
from lidcam.readers.recording import Recording

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
    """Channels of combined messages, with the parts found in their first messages.

    Raises:
        RecordingError: the recording cannot be read.
    """
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
