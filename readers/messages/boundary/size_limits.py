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
"""Bytes of a number by its type."""


class _FaultError(Exception):
    pass


def size_fault(msgtype: str, types: Typesdict) -> str:
    """Why messages of a type cannot be read at bounded cost; empty if they can. `types` has all that it contains."""
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
