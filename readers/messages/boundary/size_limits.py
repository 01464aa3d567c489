"""Bounds what decoding a message costs: checks its definition, and counts what its lists hold before it is decoded.

rosbags writes Python code for every field, and for every element of an array of strings or messages. It creates an
object for every nested message, even one of zero bytes. A decoded object takes a hundred times the memory of the byte
that may represent it: a list of a hundred million small messages fits a recording but not memory.
"""

import struct
from contextlib import suppress
from functools import lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys.store import Typestore

from readers.messages.cursor import Cursor

__all__ = ["MAX_FIELDS", "MAX_NESTING", "count_items", "size_fault"]

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


def count_items(store: Typestore, msgtype: str, encoding: str, data: bytes | memoryview, most: int) -> int:
    """The number of strings and messages in lists, in as much of the message as there is; stops beyond `most`."""
    counting = _Counting(store, encoding, memoryview(data), most)
    with suppress(struct.error, _EnoughError):  # decoding reports data that end early
        counting.whole(msgtype)
    return counting.items


class _EnoughError(Exception):
    pass


@lru_cache(maxsize=1024)
def _counted_fields(store: Typestore, msgtype: str) -> tuple[tuple[Any, ...], bool]:
    """Kinds of the fields up to the last one with items, and whether there are more of them within these."""
    kinds = [kind for _, kind in store.fielddefs[msgtype][1]]
    while kinds and not _has_items(store, kinds[-1]):
        kinds.pop()
    return tuple(kinds), bool(kinds) and (kinds[-1][0] != Nodetype.SEQUENCE or _has_items(store, kinds[-1][1][0]))


def _has_items(store: Typestore, kind: Any) -> bool:
    node, detail = kind
    if node == Nodetype.NAME:
        return any(_has_items(store, inner) for _, inner in store.fielddefs[str(detail)][1])
    if node == Nodetype.ARRAY:
        return _has_items(store, detail[0])
    return bool(node == Nodetype.SEQUENCE and _base(detail[0]) not in SIZES)


def _base(part: Any) -> str:
    """The name of a number or `string`; empty for a message."""
    return "" if part[0] == Nodetype.NAME else str(part[1][0])


class _Counting:
    """Goes over a message's bytes; arrays and lists of numbers take one step."""

    def __init__(self, store: Typestore, encoding: str, data: memoryview, most: int) -> None:
        self._store, self._most = store, most
        self._cursor = Cursor(data, encoding)
        self.items = 0

    def whole(self, msgtype: str) -> None:
        """Count the items of a message, and go no further than it takes: most have one list, before many bytes."""
        kinds, goes_within = _counted_fields(self._store, msgtype)
        if not kinds:
            return
        for kind in kinds[:-1]:
            self._field(kind)
        if goes_within:
            self._field(kinds[-1])
        else:
            self._add(self._cursor.uint32())

    def message(self, msgtype: str) -> None:
        """Count the items of a message and pass over it."""
        for _, kind in self._store.fielddefs[msgtype][1]:
            self._field(kind)

    def _field(self, kind: Any) -> None:
        """Count the items of a field and pass over it."""
        detail: Any
        node, detail = kind
        if node == Nodetype.NAME:
            self.message(str(detail))
        elif node == Nodetype.BASE:
            self._values(str(detail[0]), 1)
        else:
            part, length = detail
            count: int = self._cursor.uint32() if node == Nodetype.SEQUENCE else length
            base = _base(part)
            if node == Nodetype.SEQUENCE and base not in SIZES:
                self._add(count)
            if base:
                self._values(base, count)
                return
            for _ in range(count):
                self.message(str(part[1]))

    def _add(self, count: int) -> None:
        self.items += count
        if self.items > self._most:
            raise _EnoughError

    def _values(self, base: str, count: int) -> None:
        size = SIZES.get(base)
        if size is not None:
            self._cursor.skip(size, count)
            return
        for _ in range(count):
            self._cursor.skip(1, self._cursor.uint32())
