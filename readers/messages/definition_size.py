"""The size of a message definition, checked before rosbags generates code from it.

rosbags writes Python code for every field, and for every element of an array of strings or messages. It creates an
object for every nested message, even one of zero bytes.
"""

from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict

__all__ = ["MAX_FIELDS", "MAX_NESTING", "size_fault"]

MAX_FIELDS = 5000
"""Values in a message: a list counts as one, an array of messages as all its elements."""

MAX_NESTING = 50

_Size = tuple[int, int]
"""Number of values, and the fewest bytes that they occupy."""


class _FaultError(Exception):
    pass


def size_fault(msgtype: str, types: Typesdict) -> str:
    """Why messages of a type cannot be read at bounded cost; empty if they can.

    Args:
        msgtype: Name of the type.
        types: The type and all types that it contains.
    """
    try:
        _size(msgtype, types, {}, ())
    except _FaultError as err:
        return str(err)
    return ""


def _size(msgtype: str, types: Typesdict, known: dict[str, _Size], inside: tuple[str, ...]) -> _Size:
    if msgtype in known:
        return known[msgtype]
    if msgtype in inside:
        raise _FaultError(f"{msgtype} contains itself")
    if len(inside) == MAX_NESTING:
        raise _FaultError(f"types are nested more than {MAX_NESTING} deep")
    fields = least_bytes = 0
    for name, (node, detail) in types[msgtype][1]:
        part: Any = (node, detail)
        count = 1
        if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
            part, count = detail[0], int(detail[1])
        values, size = _part_size(part, types, known, (*inside, msgtype))
        if node == Nodetype.SEQUENCE and not size:
            raise _FaultError(f"{name} is a list of empty messages")
        if node == Nodetype.SEQUENCE:
            size, count = 4, 1
        in_one_piece = part[0] == Nodetype.BASE and part[1][0] not in {"string", "wstring"}
        fields += 1 if in_one_piece else max(values * count, 1)
        least_bytes += size * count
        if fields > MAX_FIELDS:
            raise _FaultError(f"a message holds more than {MAX_FIELDS} values")
    known[msgtype] = fields, least_bytes
    return known[msgtype]


def _part_size(part: Any, types: Typesdict, known: dict[str, _Size], inside: tuple[str, ...]) -> _Size:
    node, detail = part
    if node == Nodetype.NAME:
        return _size(detail, types, known, inside)
    return 1, 4 if detail[0] in {"string", "wstring"} else 1
