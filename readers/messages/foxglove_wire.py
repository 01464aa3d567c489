"""Protobuf and JSON messages of MCAP files as nested mappings of plain values by field name.

Sources: mcap.dev/spec/registry (a protobuf schema is a FileDescriptorSet, its name is the message's full name),
docs.foxglove.dev/docs/sdk/schemas (in JSON, bytes are base64 and a time is `{"sec": ..., "nsec": ...}`).
"""

import base64
import json
from functools import lru_cache
from typing import Any

from google.protobuf.descriptor_database import DescriptorDatabase
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel, RawMessage

__all__ = ["payload", "read_fields", "time_ns"]

Fields = dict[str, Any]


def read_fields(message: RawMessage) -> Fields:
    """The fields that are set, by name: messages as mappings, lists as lists; for bytes see `payload`.

    Raises:
        MessageError: the schema cannot be used, or the bytes do not fit it.
    """
    if message.channel.encoding == "json":
        found = json.loads(bytes(message.data))
        if not isinstance(found, dict):
            raise MessageError(f"{message.topic}: expected a JSON object, found {type(found).__name__}")
        return found
    message_class = _message_class(message.channel)
    if isinstance(message_class, str):
        raise MessageError(f"{message.topic}: {message_class}")
    return _fields(message_class.FromString(memoryview(message.data)))


def payload(value: bytes | str) -> bytes:
    """A field of bytes; in JSON it is base64.

    Raises:
        ValueError: it is not valid base64.
    """
    return base64.b64decode(value, validate=True) if isinstance(value, str) else value


def time_ns(value: Fields) -> int:
    """A google.protobuf.Timestamp, or Foxglove's JSON form of it, in nanoseconds."""
    sec: Any = value.get("sec", value.get("seconds", 0))
    nanosec: Any = value.get("nsec", value.get("nanos", 0))
    return int(sec) * 10**9 + int(nanosec)


@lru_cache(maxsize=256)
def _message_class(channel: Channel) -> Any | str:
    """The class of a protobuf channel's messages, or why there is none: failures are cached too."""
    try:
        database = DescriptorDatabase()
        for file in FileDescriptorSet.FromString(base64.b64decode(channel.definition)).file:
            database.Add(file)
        return GetMessageClass(DescriptorPool(database).FindMessageTypeByName(channel.msgtype))
    except Exception as err:  # protobuf's own errors, TypeError, KeyError or ValueError
        reason = " ".join(str(err).split())[:200]
        return f"the recorded protobuf schema of {channel.msgtype} is unusable: {type(err).__name__}: {reason}"


def _fields(message: Any) -> Fields:
    found = {}
    for descriptor, value in message.ListFields():
        if descriptor.message_type is None:
            found[descriptor.name] = value
        elif descriptor.is_repeated:
            found[descriptor.name] = [_fields(item) for item in value]
        else:
            found[descriptor.name] = _fields(value)
    return found
