"""How many strings and messages a message holds in its lists, before any object is made of it.

An object takes a hundred times the memory of the byte that may stand for it: a list of a hundred million small messages
fits a recording, but no memory. Layouts: http://wiki.ros.org/msg, and OMG CDR (formal/02-06-51, 9.3) for ROS 2.
"""

import struct
from contextlib import suppress
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

__all__ = ["count_items"]

SIZES = {
    **dict.fromkeys(("bool", "byte", "char", "octet", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "float64"), 8),
    "float128": 16,
}
CDR_ENCAPSULATION_BYTES = 4


def count_items(store: Typestore, msgtype: str, encoding: str, data: bytes | memoryview, most: int) -> int:
    """The number of strings and messages in lists, as far as the data go; counted no further than beyond `most`."""
    counting = _Counting(store, encoding, memoryview(data), most)
    with suppress(struct.error, _EnoughError):  # what ends too soon is told by decoding it
        counting.message(msgtype)
    return counting.items


class _EnoughError(Exception):
    pass


class _Counting:
    """Goes over a message's bytes; numbers in arrays and lists are passed over in one step."""

    def __init__(self, store: Typestore, encoding: str, data: memoryview, most: int) -> None:
        self._store = store
        self._aligned = encoding == "cdr"
        self._data = data[CDR_ENCAPSULATION_BYTES:] if self._aligned else data
        is_big = self._aligned and len(data) > 1 and not data[1] & 1
        self._uint32 = struct.Struct(">I" if is_big else "<I")
        self._most = most
        self._at = 0
        self.items = 0

    def message(self, msgtype: str) -> None:
        """Go over a message."""
        detail: Any
        for _, (node, detail) in self._store.fielddefs[msgtype][1]:
            if node == Nodetype.NAME:
                self.message(str(detail))
            elif node == Nodetype.BASE:
                self._values(str(detail[0]), 1)
            else:
                (part, part_detail), length = detail
                count: int = self._length() if node == Nodetype.SEQUENCE else length
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
            if count:
                self._align(size)
            self._at += size * count
            return
        for _ in range(count):
            length = self._length()
            self._at += length

    def _length(self) -> int:
        self._align(4)
        (length,) = self._uint32.unpack_from(self._data, self._at)
        self._at += 4
        return int(length)

    def _align(self, size: int) -> None:
        if self._aligned:
            self._at += -self._at % size
