"""Decodes serialised messages by the definition in the recording.

The recorded definition decides the layout (vision_msgs, foxglove_msgs and tf changed over time). Types missing from it
(before ROS 2 Iron, all) come from the ROS release that the recording names, else from Noetic or Humble; if the recorded
md5sum or hash differs from that release's, the messages cannot be decoded.
"""

import re
import struct
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from lidcam.pipeline.core.errors import MessageError, is_short_memory
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.typestores import known_type, known_types
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.text import one_line
from lidcam.readers.messages.registry import TYPES

_UINT32 = {"<": struct.Struct("<I"), ">": struct.Struct(">I")}
_ENCAPSULATION_BYTES = 4


class Cursor:
    """A place in a message that is serialised as `ros1` or `cdr`, and has not been decoded.

    ROS 1 packs fields without gaps (wiki.ros.org/msg). CDR aligns each number to its size, counted from the end of a
    four-byte encapsulation whose second byte says which end comes first (OMG formal/02-06-51, 9.3; DDSI-RTPS 10.2).
    Where the message ends, or a text is not UTF-8, reading raises a struct.error or ValueError: see `damage_told`.

    Attributes:
        order: Byte order of numbers, `<` or `>`.
        at: Position of the next byte, counted from the start of `data`.
    """

    __slots__ = ("_data", "_is_aligned", "at", "order")

    def __init__(self, data: bytes | memoryview, encoding: str) -> None:
        self._data, self._is_aligned = data, encoding == "cdr"
        self.at = _ENCAPSULATION_BYTES if self._is_aligned else 0
        self.order = ">" if self._is_aligned and len(data) > 1 and not data[1] & 1 else "<"

    def skip(self, size: int, count: int = 1) -> None:
        """Pass over numbers of `size` bytes each."""
        if count:
            self._align(size)
        self.at += size * count

    def uint32(self) -> int:
        """The next number, also the length of a list."""
        self._align(4)
        (value,) = _UINT32[self.order].unpack_from(self._data, self.at)
        self.at += 4
        return int(value)

    def string(self) -> str:
        """The next string."""
        length = self.uint32()
        encoded = bytes(self._data[self.at : self.at + length])
        self.at += length
        return encoded.rstrip(b"\0").decode()

    def frame_id(self) -> str:
        """The frame of a std_msgs/Header, which is passed over."""
        self.skip(4, 2 if self._is_aligned else 3)  # the stamp, in ROS 1 behind `seq`
        return self.string()

    def records(self, layout: np.dtype[Any], count: int) -> np.ndarray[Any, Any]:
        """(count,) the next structs, as they lie in the message."""
        step = layout.itemsize
        stride = (step + 3) // 4 * 4 if self._is_aligned else step  # in CDR to the next number, but behind the last one
        needed = self.at + (count - 1) * stride + step if count else self.at
        if needed > len(self._data):
            raise ValueError(f"expected {count} in {needed} bytes, found {len(self._data)} bytes: it is cut off")
        return np.ndarray((count,), layout, np.frombuffer(self._data, np.uint8), self.at, (stride,))

    def _align(self, size: int) -> None:
        if self._is_aligned:
            self.at += (_ENCAPSULATION_BYTES - self.at) % size


def cursor_of(message: RawMessage, *msgtypes: str) -> Cursor:
    """A cursor at the beginning of a message of one of some types."""
    if message.problem:
        raise MessageError(f"{message.topic}: {message.problem}")
    if message.channel.msgtype not in msgtypes:
        raise MessageError(f"{message.topic}: expected {' or '.join(msgtypes)}, found {message.channel.msgtype}")
    return Cursor(message.data, message.channel.encoding)


@contextmanager
def damage_told(message: RawMessage) -> Iterator[None]:
    """Turn what a cursor raises where a message ends too soon, or its text is none, into a `MessageError`."""
    try:
        yield
    except (struct.error, ValueError) as err:
        raise MessageError(
            f"{message.topic}: {len(message.data)} bytes of a {message.channel.msgtype} that is cut off or damaged "
            f"({err})"
        ) from err


MAX_FIELDS = 5000
"""Values in a message: a list counts as one, an array of messages as all its elements."""

MAX_NESTING = 50

SIZES = {
    **dict.fromkeys(("bool", "byte", "char", "octet", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "float64"), 8),
    "float128": 16,
}
"""Bytes of a number by its type."""


class _FaultError(Exception):
    pass


def size_fault(msgtype: str, types: Typesdict) -> str:
    """Why messages of a type cannot be read at bounded cost; empty if they can. `types` has all that it contains.

    rosbags writes Python code for every field, and for every element of an array of strings or messages. It creates an
    object for every nested message, even one of zero bytes. A decoded object takes a hundred times the memory of the
    byte that may represent it: a list of a hundred million small messages fits a recording but not memory.
    """
    known: dict[str, int] = {}

    def values(name: str, inside: tuple[str, ...]) -> int:
        """Number of values in a message of a type."""
        if name in inside:
            raise _FaultError(f"{name} contains itself")
        if len(inside) == MAX_NESTING:
            raise _FaultError(f"types are nested more than {MAX_NESTING} deep")
        if name not in known:
            known[name] = 0
            for field, (node, detail) in types[name][1]:
                part: Any = detail[0] if node in {Nodetype.ARRAY, Nodetype.SEQUENCE} else (node, detail)
                count = int(detail[1]) if node == Nodetype.ARRAY and part[1] not in _IN_ONE_PIECE else 1
                inner = values(part[1], (*inside, name)) if part[0] == Nodetype.NAME else 1
                if node == Nodetype.SEQUENCE and not inner:
                    raise _FaultError(f"{field} is a list of empty messages")
                known[name] += 1 if node == Nodetype.SEQUENCE else inner * count
                if known[name] > MAX_FIELDS:
                    raise _FaultError(f"a message holds more than {MAX_FIELDS} values")
        return known[name]

    try:
        values(msgtype, ())
    except _FaultError as err:
        return str(err)
    return ""


_IN_ONE_PIECE = frozenset((name, 0) for name in SIZES)
"""Details of numbers, of which rosbags reads an array at once."""


def count_items(store: Typestore, msgtype: str, encoding: str, data: bytes | memoryview, max_items: int) -> int:
    """The number of strings and messages in lists, in as much of the message as there is; stops beyond `max_items`."""
    cursor, items = Cursor(memoryview(data), encoding), 0

    def skip_message(name: str) -> None:
        kind: Any
        for _, kind in store.fielddefs[name][1]:
            node, detail = kind
            if node == Nodetype.ARRAY:
                (inner, what), length = detail
                skip_values(inner, what, length)
            elif node == Nodetype.SEQUENCE:
                skip_list(*detail[0])
            else:
                skip_values(node, detail, 1)

    def skip_list(node: Any, detail: Any) -> None:
        nonlocal items
        count = cursor.uint32()
        if node == Nodetype.NAME or detail[0] not in SIZES:
            items += count
            if items > max_items:
                raise _EnoughError
        skip_values(node, detail, count)

    def skip_values(node: Any, detail: Any, count: int) -> None:
        if node == Nodetype.BASE and detail[0] in SIZES:
            cursor.skip(SIZES[detail[0]], count)
            return
        for _ in range(count):
            if node == Nodetype.NAME:
                skip_message(str(detail))
            else:
                cursor.skip(1, cursor.uint32())

    with suppress(struct.error, _EnoughError):  # decoding reports data that end early
        skip_message(msgtype)
    return items


class _EnoughError(Exception):
    pass


# rosbag2 joins the IDL texts of a type and its dependencies under such headings.
IDL_HEADING = re.compile(r"^={80}\nIDL: .*\n", re.MULTILINE)

MD5SUM = re.compile(r"[0-9a-f]{32}")

MAX_DEFINITION_CHARACTERS = 1 << 18
EMPTY_LINES = re.compile(r"\n\s*\n")

EXACT = {"velodyne_msgs/msg/VelodyneScan", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"}
"""Types whose bytes are passed on or read in place; decoders of the others go by the recorded definition."""

_lock = threading.Lock()


def deserialize(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> Any:
    """The message as an object with the fields of its definition; byte and number arrays are numpy arrays.

    Raises:
        MessageError: the definition cannot be used, the bytes do not fit it, the message could not be read, or its
            lists hold more than `limits` allow.
    """
    channel = message.channel
    if message.problem:
        raise MessageError(f"{channel.topic}: {message.problem}")
    store = typestore_for(channel)
    max_items = limits.max_message_items  # fewer than bytes
    if len(message.data) > max_items and (
        count_items(store, channel.msgtype, channel.encoding, message.data, max_items) > max_items
    ):
        raise MessageError(
            f"{channel.topic}: a {channel.msgtype} with more than {max_items} strings or messages in its lists: raise "
            "limit_scale"
        )
    try:
        if channel.encoding == "ros1":
            return store.deserialize_ros1(message.data, channel.msgtype)
        # a view: slicing off the encapsulation would copy bytes
        return store.deserialize_cdr(memoryview(message.data), channel.msgtype)
    except Exception as err:  # the generated decoders let struct, index, value and unicode errors through
        if is_short_memory(err):
            raise
        raise MessageError(
            f"{channel.topic}: {len(message.data)} bytes are not a valid {channel.msgtype} "
            f"({type(err).__name__}: {err})"
        ) from err


def deserialize_as(message: RawMessage, *msgtypes: str, limits: RecordingLimits = DEFAULT_LIMITS) -> Any:
    """Like `deserialize`, for a message that must be of one of some types."""
    if message.channel.msgtype not in msgtypes:
        raise MessageError(f"{message.topic}: expected {' or '.join(msgtypes)}, found {message.channel.msgtype}")
    return deserialize(message, limits=limits)


def pose_numbers(pose: Any) -> tuple[list[float], list[float]]:
    """Position x, y, z and orientation x, y, z, w of a geometry_msgs/Pose."""
    at, turn = pose.position, pose.orientation
    return [at.x, at.y, at.z], [turn.x, turn.y, turn.z, turn.w]


def typestore_for(channel: Channel) -> Typestore:
    """The types that this channel's messages contain; a definition that cannot be used raises a `MessageError`."""
    store = _types_of(channel)
    if isinstance(store, str):
        raise MessageError(f"{channel.topic}: {store}")
    return store


def definition_problem(channel: Channel) -> str:
    """Why the channel's messages cannot be decoded; empty if no problem is known."""
    store = _types_of(channel)
    return store if isinstance(store, str) else ""


@lru_cache(maxsize=1024)
def _types_of(channel: Channel) -> Typestore | str:
    with _lock:  # lru_cache alone builds a store twice if two threads ask at once
        return _typestore(replace(channel, topic=""))  # thousands of topics may share one definition


@lru_cache(maxsize=256)
def _typestore(channel: Channel) -> Typestore | str:
    """The types, or why they are unusable: failures are cached too, a topic has many messages."""
    if channel.encoding not in {"ros1", "cdr"}:
        return f"{channel.msgtype} in {channel.encoding} is not a ROS message"
    try:
        recorded = _recorded_types(channel)
        release = _release(channel)
        store = known_types(release)
        types: Typesdict = {}
        wanted = [channel.msgtype]
        while wanted:
            name = wanted.pop()
            if name in types:
                continue
            found = recorded.get(name) or known_type(name, release)
            if found is None:
                needed = "" if name == channel.msgtype else f", which {channel.msgtype} needs"
                return f"the recording has no definition of {name}{needed}"
            types[name] = found
            wanted += type_parts(found[1])
        if fault := size_fault(channel.msgtype, types):
            return f"the recorded definition of {channel.msgtype} is unusable: {fault}"
        is_known = channel.msgtype in TYPES and channel.msgtype in store.fielddefs
        if is_known and (other := _other_layout(channel.msgtype, types, store.fielddefs)):
            return f"the recorded definition of {channel.msgtype} is not ROS's: {other} has other fields"
        # Where they are equal, what reads a header is made once for all channels.
        if any(types[name] != store.fielddefs.get(name) for name in types):
            store = get_typestore(Stores.EMPTY)
            store.register(types)
        if not channel.definition.strip() and (other := _other_digest(channel, store)):
            return f"the recording has no definition of {channel.msgtype}, and the one that lidcam knows is {other}"
    except Exception as err:  # e.g. names or numbers that Python does not accept: the generated code fails
        if is_short_memory(err):
            raise
        reason = one_line(err, max_characters=200)
        return f"the recorded definition of {channel.msgtype} is unusable: {type(err).__name__}: {reason}"
    return store


def _other_layout(msgtype: str, types: Typesdict, known: Typesdict) -> str:
    """A type that has other fields than in the release, among a type and those that it contains; empty if none has.

    Unless a type is one of `EXACT`, its first field alone is compared, in which the stamp lies: other fields differ
    between versions and converters (`rosbags-convert` calls those of a camera info D and K in ROS 2, too).
    """
    fields, expected = types[msgtype][1], known[msgtype][1]
    if msgtype in TYPES and msgtype not in EXACT:
        fields, expected = fields[:1], expected[:1]
    if fields != expected:
        return msgtype
    return next(filter(None, (_other_layout(part, types, known) for part in type_parts(fields))), "")


def _other_digest(channel: Channel, store: Typestore) -> str:
    """The types' md5sum or hash and the recorded one, in words; empty if they agree or none was recorded."""
    if MD5SUM.fullmatch(channel.digest):
        _, found = store.generate_msgdef(channel.msgtype)
    elif channel.digest.startswith("RIHS01_"):
        found = store.hash_rihs01(channel.msgtype)
    else:
        return ""
    return "" if found == channel.digest else f"{found}, not the recorded {channel.digest}"


def _release(channel: Channel) -> Stores:
    """The ROS release that a recording names, else Noetic or Humble."""
    if channel.encoding == "ros1":
        return Stores.ROS1_NOETIC
    named = f"ros2_{channel.distro.lower()}"
    return next((release for release in Stores if release.value == named), Stores.ROS2_HUMBLE)


def _recorded_types(channel: Channel) -> Typesdict:
    if not channel.definition.strip():
        return {}
    if len(channel.definition) > MAX_DEFINITION_CHARACTERS:
        raise ValueError(f"{len(channel.definition)} characters, expected at most {MAX_DEFINITION_CHARACTERS}")
    if channel.definition_format != "ros2idl":
        return get_types_from_msg(EMPTY_LINES.sub("\n", channel.definition), channel.msgtype)
    types: Typesdict = {}
    for text in IDL_HEADING.split(channel.definition):
        if text.strip():
            types |= get_types_from_idl(text)
    return types


def type_parts(fields: Iterable[Any]) -> Iterator[str]:
    """Names of the message types among fields."""
    for _, (node, detail) in fields:
        if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
            node, detail = detail[0]
        if node == Nodetype.NAME:
            yield detail
