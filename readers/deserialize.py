"""Serialised messages to plain objects, by the definition that the recording itself carries.

The recorded definition decides the layout (vision_msgs, foxglove_msgs and tf changed over time). A recording without
definitions (ROS 2 before Iron) is read by those of the ROS 2 release that it names, else of Humble.
"""

import threading
from functools import lru_cache
from typing import Any

from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pipeline.errors import MessageError
from pipeline.types import Channel, RawMessage

__all__ = ["deserialize", "typestore_for"]

_lock = threading.Lock()


def deserialize(message: RawMessage) -> Any:
    """The message as an object with the fields of its definition; byte and number arrays are numpy arrays.

    Raises:
        MessageError: the definition cannot be used, or the bytes do not fit it.
    """
    channel = message.channel
    store = typestore_for(channel)
    try:
        if channel.encoding == "ros1":
            return store.deserialize_ros1(message.data, channel.msgtype)
        return store.deserialize_cdr(message.data, channel.msgtype)
    except Exception as err:  # the generated decoders let struct, index, value and unicode errors through
        raise MessageError(
            f"{channel.topic}: {len(message.data)} bytes are no {channel.msgtype} ({type(err).__name__}: {err})"
        ) from err


def typestore_for(channel: Channel) -> Typestore:
    """The types that this channel's messages are built of.

    Raises:
        MessageError: the definition cannot be parsed, or there is none and the type is not a common one.
    """
    with _lock:  # lru_cache alone would build a store twice when two threads ask at once
        return _typestore(channel)


@lru_cache(maxsize=256)
def _typestore(channel: Channel) -> Typestore:
    if not channel.definition.strip():
        store = get_typestore(_release_of(channel))
        if channel.msgtype not in store.fielddefs:
            raise MessageError(f"{channel.topic}: the recording has no definition of {channel.msgtype}")
        return store
    store = get_typestore(Stores.EMPTY)
    try:
        if channel.definition_format == "ros2idl":
            types = get_types_from_idl(channel.definition)
        else:
            types = get_types_from_msg(channel.definition, channel.msgtype)
        store.register(types)
    except (TypesysError, ValueError, KeyError) as err:
        raise MessageError(f"{channel.topic}: the recorded definition of {channel.msgtype} is unusable: {err}") from err
    return store


def _release_of(channel: Channel) -> Stores:
    if channel.encoding == "ros1":
        return Stores.ROS1_NOETIC
    wanted = f"ros2_{channel.distro.lower()}"
    return next((store for store in Stores if store.value == wanted), Stores.ROS2_HUMBLE)
