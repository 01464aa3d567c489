"""What lidcam needs of a recorded definition: the fields that its decoders read, each of a kind that they can use.

A type's name does not say what its messages hold: a package of one's own may have a `sensor_msgs/Image` of another
layout. So a definition is compared with the `FIELDS` of its decoder's module (see `registry`) once, when it is first
used; a topic that falls short of them cannot be decoded, for one reason, and decoders may rely on every field that they
read. Further fields, other orders and wider numbers do not matter: messages are decoded as their own definition says.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict

from readers.messages.registry import TYPES, fields_of

__all__ = [
    "BYTES",
    "COVARIANCE",
    "FLOATS",
    "HEADER",
    "NUMBER",
    "POINT",
    "POSE",
    "TEXT",
    "TIME",
    "WHOLE",
    "Fields",
    "Need",
    "Values",
    "layout_fault",
]


@dataclass(frozen=True, slots=True)
class Values:
    """A number or a text, or a list of them.

    Attributes:
        words: What is expected.
        types: The types that will do, as rosbags calls them.
        length: None of a single one; of a list its length, 0 if any will do.
    """

    words: str
    types: frozenset[str]
    length: int | None = None


Need: TypeAlias = "Values | list[Need] | tuple[Need, ...] | Mapping[str, Need]"
"""A list is one of messages, a tuple one of several, as versions of a type differ; a mapping is a nested message."""

Fields = Mapping[str, Need]
"""By the name of a field, or by several names that it may have, with `|` between them."""

_WHOLE = frozenset(
    ("bool", "byte", "char", "octet", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
)
FLOATS = frozenset({"float32", "float64"})
WHOLE = Values("a whole number", _WHOLE)
NUMBER = Values("a number", _WHOLE | FLOATS)
TEXT = Values("a string", frozenset({"string", "wstring"}))
BYTES = Values("uint8[]", frozenset({"uint8", "byte", "char", "octet"}), 0)
COVARIANCE = Values("float64[36]", FLOATS, 36)
TIME: Fields = {
    "sec": Values("int32", frozenset({"int32", "uint32"})),
    "nanosec": Values("uint32", frozenset({"uint32"})),
}
HEADER: Fields = {"stamp": TIME, "frame_id": TEXT}
POINT: Fields = dict.fromkeys("xyz", NUMBER)
POSE: Fields = {"position": POINT, "orientation": dict.fromkeys("xyzw", NUMBER)}

_LISTS = {Nodetype.ARRAY, Nodetype.SEQUENCE}
_HEADER = "std_msgs/msg/Header"


def layout_fault(msgtype: str, types: Typesdict, known: Typesdict) -> str:
    """What lidcam needs of a type and its definition does not have; empty if it has all, or the type is not read.

    Args:
        msgtype: Name of the type.
        types: The recorded definitions of the type and those that it contains.
        known: The definitions of the ROS release.
    """
    if msgtype not in TYPES:
        return ""
    needs = fields_of(msgtype)
    if fault := _message_fault(msgtype, needs, types, ""):
        return fault
    # The stamp must lie where `peek_stamp_ns` reads it, before a message is decoded.
    if "header" in needs and not (
        types[msgtype][1][0] == ("header", (Nodetype.NAME, _HEADER)) and _is_same(_HEADER, types, known)
    ):
        return f"it does not begin with a {_HEADER}"
    if TYPES[msgtype].is_exact and not _is_same(msgtype, types, known):
        return f"its fields do not lie as in ROS's {msgtype}"
    return ""


def _message_fault(msgtype: str, needs: Fields, types: Typesdict, path: str) -> str:
    found = dict(types[msgtype][1])
    for names, need in needs.items():
        name = next((name for name in names.split("|") if name in found), "")
        place = f"{path}{names.split('|')[0]}"
        if not name:
            return f"it has no field {place}"
        if fault := _fault(found[name], need, types, place):
            return fault
    return ""


def _fault(field: Any, need: Need, types: Typesdict, place: str) -> str:
    node, detail = field
    if isinstance(need, tuple):
        faults = [_fault(field, one, types, place) for one in need]
        return faults[0] if all(faults) else ""
    if isinstance(need, Mapping):
        if node == Nodetype.NAME:
            return _message_fault(str(detail), need, types, f"{place}.")
        words = "a message"
    elif isinstance(need, list):
        if node in _LISTS:
            return _fault(detail[0], need[0], types, f"{place}[]")
        words = "a list"
    else:
        if need.length is None:
            fits = node == Nodetype.BASE and detail[0] in need.types
        else:
            fits = node in _LISTS and detail[0][0] == Nodetype.BASE and detail[0][1][0] in need.types
            fits = fits and (not need.length or (node == Nodetype.ARRAY and detail[1] == need.length))
        if fits:
            return ""
        words = need.words
    return f"its field {place} is {_words(field)}, expected {words}"


def _is_same(msgtype: str, types: Typesdict, known: Typesdict) -> bool:
    """Whether two definitions have the same fields, and their fields' types the same, too."""
    if types[msgtype][1] != known[msgtype][1]:
        return False
    inner: list[Any] = [detail[0] if node in _LISTS else (node, detail) for _, (node, detail) in types[msgtype][1]]
    return all(_is_same(str(detail), types, known) for node, detail in inner if node == Nodetype.NAME)


def _words(field: Any) -> str:
    node, detail = field
    if node in _LISTS:
        length = detail[1] if node == Nodetype.ARRAY else ""
        return f"{_words(detail[0])}[{length}]"
    return str(detail[0] if node == Nodetype.BASE else detail)
