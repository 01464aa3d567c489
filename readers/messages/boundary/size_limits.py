"""Bounds what decoding a message costs: checks its definition, and counts what its lists hold before it is decoded.

rosbags writes Python code for every field, and for every element of an array of strings or messages. It creates an
object for every nested message, even one of zero bytes. A decoded object takes a hundred times the memory of the byte
that may represent it: a list of a hundred million small messages fits a recording but not memory.
"""

import struct
from contextlib import suppress
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys.store import Typestore

from lidcam.readers.messages.cursor import Cursor

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
    fields = min_bytes = 0
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
        min_bytes += size * count
        if fields > MAX_FIELDS:
            raise _FaultError(f"a message holds more than {MAX_FIELDS} values")
    known[msgtype] = fields, min_bytes
    return known[msgtype]


def _part_size(part: Any, types: Typesdict, known: dict[str, _Size], inside: tuple[str, ...]) -> _Size:
    node, detail = part
    if node == Nodetype.NAME:
        return _size(detail, types, known, inside)
    return 1, 4 if detail[0] in {"string", "wstring"} else 1


def count_items(store: Typestore, msgtype: str, encoding: str, data: bytes | memoryview, max_items: int) -> int:
    """The number of strings and messages in lists, in as much of the message as there is; stops beyond `max_items`."""
    counting = _Counting(store, encoding, memoryview(data), max_items)
    with suppress(struct.error, _EnoughError):  # decoding reports data that end early
        counting.message(msgtype)
    return counting.items


class _EnoughError(Exception):
    pass


class _Counting:
    """Goes over a message's bytes; arrays and lists of numbers take one step."""

    def __init__(self, store: Typestore, encoding: str, data: memoryview, max_items: int) -> None:
        self._store, self._max_items = store, max_items
        self._cursor = Cursor(data, encoding)
        self.items = 0

    def message(self, msgtype: str) -> None:
        """Count the items of a message and pass over it."""
        kind: Any
        for _, kind in self._store.fielddefs[msgtype][1]:
            node, detail = kind
            if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
                (part, what), length = detail
                self._list(part, what, length if node == Nodetype.ARRAY else None)
            else:
                self._values(node, detail, 1)

    def _list(self, part: Any, what: Any, length: int | None) -> None:
        count = self._cursor.uint32() if length is None else length
        if length is None and (part == Nodetype.NAME or what[0] not in SIZES):
            self.items += count
            if self.items > self._max_items:
                raise _EnoughError
        self._values(part, what, count)

    def _values(self, node: Any, what: Any, count: int) -> None:
        """Pass over values of one type that follow each other."""
        if node == Nodetype.BASE and what[0] in SIZES:
            self._cursor.skip(SIZES[what[0]], count)
            return
        for _ in range(count):
            if node == Nodetype.NAME:
                self.message(str(what))
            else:
                self._cursor.skip(1, self._cursor.uint32())
