"""Protobuf and JSON messages of MCAP files as nested mappings of plain values by field name.

Sources: mcap.dev/spec/registry (a protobuf schema is a FileDescriptorSet, its name is the message's full name),
docs.foxglove.dev/docs/sdk/schemas (in JSON, bytes are base64 and a time is `{"sec": ..., "nsec": ...}`).
"""

import base64
import json
from functools import lru_cache
from typing import Any

from pipeline.core.errors import MessageError, is_short_memory
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from pipeline.core.text import one_line

__all__ = ["payload", "read_fields", "time_ns"]

Fields = dict[str, Any]

JSON_ITEMS = (b",", b"{", b"[")
"""Bytes that come before each value but the first, which is none of those that make up base64."""

VARINT, LENGTH, FIXED_BYTES = 0, 2, {1: 8, 5: 4}
MAX_VARINT_BYTES = 10


def read_fields(message: RawMessage, *, limits: LimitsConfig = DEFAULT_LIMITS) -> Fields:
    """The fields that are set, by name: messages as mappings, lists as lists; for bytes see `payload`.

    Raises:
        MessageError: the schema cannot be used, the bytes do not fit it, or they hold more values than `limits` allow.
    """
    if message.channel.encoding == "json":
        text = bytes(message.data)
        _check_items(sum(map(text.count, JSON_ITEMS)), message.topic, limits)
        found = json.loads(text)
        if not isinstance(found, dict):
            raise MessageError(f"{message.topic}: expected a JSON object, found {type(found).__name__}")
        return found
    message_class = _message_class(message.channel)
    if isinstance(message_class, str):
        raise MessageError(f"{message.topic}: {message_class}")
    data = memoryview(message.data)
    most = limits.max_message_items
    _check_items(_count_values(data, message_class.DESCRIPTOR, most), message.topic, limits)
    return _fields(message_class.FromString(data))


def _check_items(items: int, topic: str, limits: LimitsConfig) -> None:
    if items > limits.max_message_items:
        raise MessageError(
            f"{topic}: a message with more than {limits.max_message_items} values: raise limits.max_message_items"
        )


def _count_values(data: memoryview, descriptor: Any, most: int) -> int:
    """Number of values in a protobuf message, texts and bytes as one each; stops beyond `most`, and at damage.

    Google's parser holds a hundred bytes for a nested message of two.
    """
    count, waiting = 0, [(data, descriptor)]
    while waiting:
        part, kind = waiting.pop()
        at = 0
        while at < len(part) and count <= most:
            count += 1
            key, at = _varint(part, at)
            wire = key & 7
            if wire == VARINT:
                _, at = _varint(part, at)
            elif wire != LENGTH:
                at += FIXED_BYTES.get(wire, 0)
            else:
                size, at = _varint(part, at)
                field = None if kind is None else kind.fields_by_number.get(key >> 3)
                if field is not None and field.message_type is not None:
                    waiting.append((part[at : at + size], field.message_type))
                elif field is not None and field.type not in {field.TYPE_BYTES, field.TYPE_STRING}:
                    count += min(size, len(part) - at)  # numbers one after the other, a byte each or more
                at += size
    return count


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """A number, and where it ends; at the end of the data zero."""
    value = 0
    for place, byte in enumerate(data[at : at + MAX_VARINT_BYTES]):
        value |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            return value, at + place + 1
    return 0, len(data)


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
    # Google's library is imported for recordings that have such messages.
    from google.protobuf.descriptor_database import DescriptorDatabase
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    try:
        database = DescriptorDatabase()
        for file in FileDescriptorSet.FromString(base64.b64decode(channel.definition)).file:
            database.Add(file)
        return GetMessageClass(DescriptorPool(database).FindMessageTypeByName(channel.msgtype))
    except Exception as err:  # protobuf's own errors, TypeError, KeyError or ValueError
        if is_short_memory(err):
            raise
        reason = one_line(err, max_characters=200)
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
