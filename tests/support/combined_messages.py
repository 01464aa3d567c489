"""Combined messages of the predecessor system, built with rosbags from messages of single sensors."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Literal

from builders import store_for
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pipeline.core.messages import Channel, RawMessage
from readers.messages.deserialize import deserialize

__all__ = ["CAMERAS", "CLOUDS", "combined"]

CAMERAS, CLOUDS = "msgs/msg/MsgCamera", "msgs/msg/ListPointCloud"
DEFINITIONS = {
    CAMERAS: "Header header\nsensor_msgs/Image[] camera",
    CLOUDS: "Header header\nsensor_msgs/PointCloud2[] pointcloud",
}
FIELDS = {CAMERAS: "camera", CLOUDS: "pointcloud"}
Encoding = Literal["ros1", "cdr"]


@lru_cache
def _types(encoding: Encoding, msgtype: str, definition: str) -> tuple[Typestore, str]:
    store = get_typestore(Stores.EMPTY)
    store.register({**store_for(encoding).fielddefs, **get_types_from_msg(definition, msgtype)})
    text, _ = store.generate_msgdef(msgtype, ros_version=1 if encoding == "ros1" else 2)
    return store, text


def combined(
    topic: str,
    msgtype: str,
    parts: Sequence[RawMessage],
    log_time_ns: int,
    encoding: Encoding,
    *,
    definition: str = "",
    field: str = "",
    order: tuple[int, ...] = (0, 0),
) -> RawMessage:
    """One message of all parts, stamped with the time of recording.

    Args:
        topic: Its topic.
        msgtype: `CAMERAS` or `CLOUDS`, or another type with its `definition` and the `field` of the list.
        parts: Messages of the sensors, already in `encoding`.
        log_time_ns: Time of recording.
        encoding: Of the combined message and its parts.
        definition: Definition of another type.
        field: Name of that type's list.
        order: Place in the recording.
    """
    store, text = _types(encoding, msgtype, definition or DEFINITIONS[msgtype])
    sec, nanosec = divmod(log_time_ns, 10**9)
    Header, Time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    seq: dict[str, Any] = {"seq": 0} if encoding == "ros1" else {}
    header = Header(**seq, stamp=Time(sec, nanosec), frame_id="")
    lists = {field or FIELDS[msgtype]: [deserialize(part) for part in parts]}
    message = store.types[msgtype](header=header, **lists)
    serialize = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
    channel = Channel(topic, msgtype, encoding, text, "ros1msg" if encoding == "ros1" else "ros2msg")
    return RawMessage(log_time_ns, log_time_ns, order, bytes(serialize(message, msgtype)), channel)
