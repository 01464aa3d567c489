"""Counts the strings and messages in a message's lists before it is decoded.

A decoded object takes a hundred times the memory of the byte that may represent it: a list of a hundred million small
messages fits a recording but not memory.
"""

import struct
from contextlib import suppress
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from readers.messages.cursor import Cursor

__all__ = ["count_items"]

SIZES = {
    **dict.fromkeys(("bool", "byte", "char", "octet", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "float64"), 8),
    "float128": 16,
}


def count_items(store: Typestore, msgtype: str, encoding: str, data: bytes | memoryview, most: int) -> int:
    """The number of strings and messages in lists, in as much of the message as there is; stops beyond `most`."""
    counting = _Counting(store, encoding, memoryview(data), most)
    with suppress(struct.error, _EnoughError):  # decoding reports data that end early
        counting.message(msgtype)
    return counting.items


class _EnoughError(Exception):
    pass


class _Counting:
    """Goes over a message's bytes; arrays and lists of numbers take one step."""

    def __init__(self, store: Typestore, encoding: str, data: memoryview, most: int) -> None:
        self._store, self._most = store, most
        self._cursor = Cursor(data, encoding)
        self.items = 0

    def message(self, msgtype: str) -> None:
        """Count the items of a message and pass over it."""
        detail: Any
        for _, (node, detail) in self._store.fielddefs[msgtype][1]:
            if node == Nodetype.NAME:
                self.message(str(detail))
            elif node == Nodetype.BASE:
                self._values(str(detail[0]), 1)
            else:
                (part, part_detail), length = detail
                count: int = self._cursor.uint32() if node == Nodetype.SEQUENCE else length
                is_name = part == Nodetype.NAME
                base = "" if is_name else str(part_detail[0])
                if node == Nodetype.SEQUENCE and base not in SIZES:
                    self.items += count
                    if self.items > self._most:
                        raise _EnoughError
                if not is_name:
                    self._values(base, count)
                    continue
                for _ in range(count):
                    self.message(str(part_detail))

    def _values(self, base: str, count: int) -> None:
        size = SIZES.get(base)
        if size is not None:
            self._cursor.skip(size, count)
            return
        for _ in range(count):
            self._cursor.skip(1, self._cursor.uint32())
