"""Messages as little-endian CDR (OMG, "CDR encapsulation", version 1), for those that are written by the thousand.

The bytes are those of rosbags' writers, in a third of their time: numbers that follow each other are packed at once,
without a pass that only counts bytes, and points may be given as one array.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

__all__ = ["ALIGNMENT", "CODES", "HEAD", "CdrEncoder"]

Step = Callable[[bytearray, Any], None]

HEAD = b"\0\1\0\0"
CODES = {
    "bool": "?",
    "byte": "b",
    "octet": "B",
    "char": "B",
    "int8": "b",
    "int16": "h",
    "int32": "i",
    "int64": "q",
    "uint8": "B",
    "uint16": "H",
    "uint32": "I",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""As `struct` calls the numbers, and numpy."""

ALIGNMENT = 8
"""The largest; where bytes begin modulo this says how many are left out before the numbers that follow."""


class CdrEncoder:
    """Encodes messages of a type store.

    A sequence of messages that hold numbers of one type alone, as points do, may be an array (N, numbers of each).

    Args:
        store: Knows the types.
    """

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._steps: dict[str, Step] = {}

    def encode(self, message: Any) -> memoryview:
        """The bytes of a message.

        Raises:
            struct.error: a number does not fit its field.
            ValueError: an array does not.
        """
        out = bytearray(HEAD)
        self._of(message.__msgtype__)(out, message)
        return memoryview(out).toreadonly()

    def _of(self, msgtype: str) -> Step:
        """What appends a message of this type."""
        if msgtype not in self._steps:
            steps: list[Step] = []
            run: list[tuple[str, str]] = []  # numbers that follow each other: code and name
            for name, kind in self._flat(msgtype):
                if kind[0] == Nodetype.BASE and kind[1][0] in CODES:
                    run.append((CODES[kind[1][0]], name))
                    continue
                if run:
                    steps.append(_numbers(run))
                    run = []
                steps.append(self._variable(name, kind))
            if run:
                steps.append(_numbers(run))
            self._steps[msgtype] = steps[0] if len(steps) == 1 else _all(tuple(steps))
        return self._steps[msgtype]

    def _flat(self, msgtype: str, prefix: str = "") -> Iterator[tuple[str, Any]]:
        """Fields with those of the messages within, by dotted names."""
        for name, kind in self._store.get_msgdef(msgtype).fields:
            if kind[0] == Nodetype.NAME:
                yield from self._flat(kind[1], f"{prefix}{name}.")
            else:
                yield prefix + name, kind

    def _variable(self, name: str, kind: Any) -> Step:
        get = attrgetter(name)
        if kind[0] == Nodetype.BASE:
            return lambda out, message: _append_text(out, get(message))
        (of, what), length = kind[1][0], kind[1][1] if kind[0] == Nodetype.ARRAY else None
        if of == Nodetype.BASE:
            if what[0] in CODES:
                return _array(get, CODES[what[0]], length)
            return _each(get, _append_text, length)
        each = _each(get, self._of(what), length)
        inner = [field[1][0] if field[0] == Nodetype.BASE else "" for _, field in self._flat(what)]
        is_uniform = len(set(inner)) == 1 and inner[0] in CODES
        return _rows(get, CODES[inner[0]], len(inner), each) if is_uniform and length is None else each


def _packers(codes: Sequence[str]) -> tuple[Callable[..., bytes], ...]:
    """For each place modulo `ALIGNMENT` where `out` may end, what packs numbers behind it."""
    found = []
    for place in range(ALIGNMENT):
        end, layout = place - len(HEAD), "<"
        for code in codes:
            size = struct.calcsize(f"<{code}")
            layout += "x" * (-end % size) + code
            end += -end % size + size
        found.append(struct.Struct(layout).pack)
    return tuple(found)


_COUNT = _packers("I")


def _all(steps: tuple[Step, ...]) -> Step:
    def append(out: bytearray, message: Any) -> None:
        for step in steps:
            step(out, message)

    return append


def _numbers(run: Sequence[tuple[str, str]]) -> Step:
    pack, get = _packers([code for code, _ in run]), attrgetter(*(name for _, name in run))
    if len(run) == 1:

        def append_one(out: bytearray, message: Any) -> None:
            out += pack[len(out) % ALIGNMENT](get(message))

        return append_one

    def append(out: bytearray, message: Any) -> None:
        out += pack[len(out) % ALIGNMENT](*get(message))

    return append


def _append_text(out: bytearray, text: str) -> None:
    encoded = text.encode()
    out += _COUNT[len(out) % ALIGNMENT](len(encoded) + 1)
    out += encoded
    out.append(0)


def _check_length(values: Any, length: int) -> None:
    if len(values) != length:
        raise ValueError(f"an array: expected {length} values, found {len(values)}")


def _each(get: Callable[[Any], Any], append_one: Step, length: int | None) -> Step:
    """Items one after another, with their count unless the type says it."""

    def append(out: bytearray, message: Any) -> None:
        values = get(message)
        if length is None:
            out += _COUNT[len(out) % ALIGNMENT](len(values))
        else:
            _check_length(values, length)
        for value in values:
            append_one(out, value)

    return append


def _array(get: Callable[[Any], Any], code: str, length: int | None) -> Step:
    """Numbers of an array (N,), with their count unless the type says it."""

    def append(out: bytearray, message: Any) -> None:
        values = get(message)
        if length is None:
            out += _COUNT[len(out) % ALIGNMENT](len(values))
        else:
            _check_length(values, length)
        _append_numbers(out, values, code)

    return append


def _rows(get: Callable[[Any], Any], code: str, width: int, each: Step) -> Step:
    """Messages of `width` numbers: the rows of an array, or one after another."""

    def append(out: bytearray, message: Any) -> None:
        values = get(message)
        if not isinstance(values, np.ndarray):
            each(out, message)
            return
        if values.ndim != 2 or values.shape[1] != width:
            raise ValueError(f"an array: expected (N, {width}) values, found {values.shape}")
        out += _COUNT[len(out) % ALIGNMENT](len(values))
        _append_numbers(out, values, code)

    return append


def _append_numbers(out: bytearray, values: Any, code: str) -> None:
    kind = np.dtype(f"<{code}")
    if len(values):
        out += bytes(-(len(out) - len(HEAD)) % kind.itemsize)
        out += np.asarray(values, kind).tobytes()
