"""Messages of types whose definitions differ from those that rosbags knows: other versions of a package."""

from collections.abc import Mapping
from typing import Any

import builders
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from lidcam.pipeline.core.messages import RawMessage


def message_of_layout(
    msgtype: str,
    definitions: Mapping[str, str],
    encoding: builders.Encoding,
    body: dict[str, Any],
    *,
    topic: str,
    stamp_ns: int,
) -> RawMessage:
    """A message of a type as the definitions have it; what they do not define is that of Noetic or Foxy."""
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_FOXY)
    types = {}
    for name, text in definitions.items():
        types.update(get_types_from_msg(text, name))
    store.register({name: found for name, found in types.items() if name not in store.fielddefs})
    return builders.raw(topic, msgtype, body, stamp_ns, encoding=encoding, store=store)
