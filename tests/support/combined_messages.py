"""Combined messages of the predecessor system, built with rosbags from messages of single sensors."""

from collections.abc import Sequence
from functools import lru_cache

from builders import Encoding, header, raw, store_for
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize

CAMERAS, CLOUDS = "msgs/msg/MsgCamera", "msgs/msg/ListPointCloud"
DEFINITIONS = {
    CAMERAS: "Header header\nsensor_msgs/Image[] camera",
    CLOUDS: "Header header\nsensor_msgs/PointCloud2[] pointcloud",
}
FIELDS = {CAMERAS: "camera", CLOUDS: "pointcloud"}


@lru_cache
def _types(encoding: Encoding, msgtype: str, definition: str) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register({**store_for(encoding).fielddefs, **get_types_from_msg(definition, msgtype)})
    return store


def combined(
    topic: str,
    msgtype: str,
    parts: Sequence[RawMessage],
    log_time_ns: int,
    encoding: Encoding,
    *,
    definition: str = "",
    field: str = "",
) -> RawMessage:
    """One message of all parts, stamped with the time of recording."""
    store = _types(encoding, msgtype, definition or DEFINITIONS[msgtype])
    body = {"header": header(log_time_ns, ""), field or FIELDS[msgtype]: [deserialize(part) for part in parts]}
    return raw(topic, msgtype, body, log_time_ns, encoding=encoding, store=store)
