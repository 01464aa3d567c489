"""Recorded ROS messages as CDR with definitions of ROS 2, to be written to a ROS 2 file.

CDR messages stay byte for byte as they are. A ROS 1 type takes the definition that ROS 2 Humble has under its name if
that holds all of its fields (`sensor_msgs/CameraInfo`: `D` becomes `d`), else it keeps its own; a header loses `seq`.
ROS 1's vision_msgs do not fit those of ROS 2: see `vision`.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.ros.messages import ROS2
from pipeline.core.ros.typestores import message_types
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from readers.messages.boundary.decoding import decoder
from readers.messages.conversion.vision import INSTANCE, VISION_ARRAYS, name_of_number, vision_message
from readers.messages.conversion.vision_in_place import boxes_in_place
from readers.messages.deserialize import deserialize, type_parts, typestore_for

__all__ = ["to_ros2"]

HEADER = "std_msgs/msg/Header"

RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""Types that ROS 2 calls otherwise, as rosbags has them, whose converter takes long to import."""


_AS_NUMBERED = partial(name_of_number, classes=())


@decoder
def to_ros2(
    message: RawMessage,
    name_of: Callable[[int], str] = _AS_NUMBERED,
    *,
    limits: LimitsConfig = DEFAULT_LIMITS,
) -> RawMessage:
    """The message as CDR, with the definition that its channel needs in a file; times and order are kept.

    Args:
        message: Any ROS message.
        name_of: What a number in ROS 1's vision_msgs stands for.
        limits: What a message that is converted may hold.

    Raises:
        MessageError: the message could not be read, is none of ROS, or does not fit its definition.
    """
    channel = message.channel
    if message.problem:
        raise MessageError(f"{channel.topic}: {message.problem}")
    if channel.encoding == "cdr":
        return message._replace(channel=_defined(channel))
    if channel.encoding != "ros1":
        raise MessageError(f"{channel.topic}: {channel.msgtype} in {channel.encoding} is not a ROS message")
    if channel.msgtype in VISION_ARRAYS and len(message.data) <= limits.max_message_items:  # fewer items than bytes
        data = boxes_in_place(message, name_of, INSTANCE)
        if data is not None:
            return message._replace(channel=_of_vision(channel), data=data)
    recorded = deserialize(message, limits=limits)
    if channel.msgtype in VISION_ARRAYS:
        converted = vision_message(recorded, channel.msgtype, name_of)
        return message._replace(channel=_of_vision(channel), data=ROS2.serialize(converted))
    store, in_ros2, fits = _in_ros2(channel)
    if fits:
        return message._replace(channel=in_ros2, data=store.serialize_cdr(recorded, in_ros2.msgtype))
    from rosbags.convert.converter import migrate_message  # 0.1 s: it brings the readers and writers of all bags

    moved: Any = migrate_message(typestore_for(channel), store, channel.msgtype, in_ros2.msgtype, {}, recorded)
    return message._replace(channel=in_ros2, data=store.serialize_cdr(moved, in_ros2.msgtype))


@lru_cache(maxsize=1024)
def _of_vision(channel: Channel) -> Channel:
    definition = ROS2.definition(channel.msgtype)
    return replace(channel, encoding="cdr", definition=definition, definition_format="ros2msg", digest="")


@lru_cache(maxsize=1024)
def _defined(channel: Channel) -> Channel:
    """The channel with the definition that it was recorded with, or that of its release if it was recorded without."""
    if channel.definition.strip():
        return channel
    definition, _ = typestore_for(channel).generate_msgdef(channel.msgtype, ros_version=2)
    return replace(channel, definition=definition, definition_format="ros2msg")


@lru_cache(maxsize=1024)
def _in_ros2(channel: Channel) -> tuple[Typestore, Channel, bool]:
    """The types of ROS 2 for a ROS 1 channel, and the channel that has them.

    Also whether recorded messages can be written as they are: the type has no other name, and all fields are recorded.
    """
    recorded, humble = typestore_for(channel).fielddefs, message_types(2).fielddefs
    msgtype = RENAMED.get(channel.msgtype, channel.msgtype)
    types: Typesdict = {}
    wanted = [(channel.msgtype, msgtype)]
    while wanted:
        name, renamed = wanted.pop()
        if renamed in types:
            continue
        types[renamed] = humble[renamed] if _holds(humble, renamed, recorded[name]) else recorded[name]
        wanted += [(part, part) for part in type_parts(types[renamed])]
    store = get_typestore(Stores.EMPTY)
    store.register({name: definition for name, definition in types.items() if name not in store.fielddefs})
    definition, _ = store.generate_msgdef(msgtype, ros_version=2)
    in_ros2 = replace(
        channel, msgtype=msgtype, encoding="cdr", definition=definition, definition_format="ros2msg", digest=""
    )
    fits = msgtype == channel.msgtype and all(
        field in recorded[name][1] for name in types for field in store.fielddefs[name][1]
    )
    return store, in_ros2, fits


def _holds(humble: Typesdict, name: str, recorded: Any) -> bool:
    """Whether Humble's definition of a type has every field of the recorded one; the case of names may differ."""
    if name not in humble:
        return False
    if name == HEADER:
        return True
    fields = {field.lower(): kind for field, kind in humble[name][1]}
    return all(fields.get(field.lower()) == kind for field, kind in recorded[1])
