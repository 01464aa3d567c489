"""What appends a field of row after row to little-endian CDR, each piece behind what its alignment leaves out."""

import struct
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from pipeline.core.arrays import Array
from pipeline.core.ros.cdr import ALIGNMENT, HEAD

__all__ = [
    "Step",
    "all_of",
    "empty_list",
    "lists",
    "number_lists",
    "numbers",
    "same_for_all",
    "starts_of",
    "texts",
]

Step = Callable[[bytearray, int], None]
"""Appends what a row has, given by its number."""

_PADDING = {size: [bytes((len(HEAD) - place) % size) for place in range(ALIGNMENT)] for size in (1, 2, 4, 8)}
"""By size of the numbers that follow, and by where bytes end modulo `ALIGNMENT`, what is left out before them."""

_COUNTS = _PADDING[4]
_LENGTH = struct.Struct("<I")


def all_of(steps: Sequence[Step]) -> Step:
    """One step after another."""
    if len(steps) == 1:
        return steps[0]

    def append(out: bytearray, row: int) -> None:
        for step in steps:
            step(out, row)

    return append


def same_for_all(append_one: Step) -> Step:
    """What a step appends for row 0, for all rows; made once for each place where it may begin."""
    made: dict[int, bytearray] = {}

    def append(out: bytearray, _row: int) -> None:
        place = len(out) % ALIGNMENT
        if place not in made:
            behind = bytearray(place)
            append_one(behind, 0)
            made[place] = behind[place:]
        out += made[place]

    return append


def _fixed(size: int, data: bytes) -> Step:
    padding = _PADDING[size]

    def append(out: bytearray, _row: int) -> None:
        out += padding[len(out) % ALIGNMENT]
        out += data

    return append


def numbers(code: str, width: int, value: Any, count: int) -> Step:
    """`width` numbers of one type: an array (N, width), a tuple for all rows, or zeros; of one number (N,) or itself.

    Raises:
        struct.error: a number does not fit.
        ValueError: an array does not.
    """
    size = _SIZES[code]
    if isinstance(value, np.ndarray):
        if value.shape != (count, width) and (width != 1 or value.shape != (count,)):
            raise ValueError(f"an array: expected {(count, width)} values, found {value.shape}")
        return _numbers_of_rows(code, size, width, value)
    if value is None:
        return _fixed(size, bytes(size * width))
    pack = _packer(code, width)
    return _fixed(size, pack(*value) if isinstance(value, tuple) else pack(value))


@cache
def _packer(code: str, width: int) -> Callable[..., bytes]:
    return struct.Struct(f"<{width}{code}").pack


def _numbers_of_rows(code: str, size: int, width: int, values: Array) -> Step:
    padding, length, data = _PADDING[size], size * width, memoryview(_as_bytes(values, code))

    def append(out: bytearray, row: int) -> None:
        out += padding[len(out) % ALIGNMENT]
        out += data[row * length : (row + 1) * length]

    return append


def texts(value: str | Sequence[str] | None, count: int) -> Step:
    """One text for all rows, or one for each.

    Raises:
        ValueError: there are more or fewer.
    """
    if value is None or isinstance(value, str):
        return _fixed(_LENGTH.size, _encoded(value or ""))
    if len(value) != count:
        raise ValueError(f"texts: expected {count}, found {len(value)}")
    encoded = [_encoded(text) for text in value]

    def append(out: bytearray, row: int) -> None:
        out += _COUNTS[len(out) % ALIGNMENT]
        out += encoded[row]

    return append


def starts_of(counts: Array | Sequence[int] | int, count: int) -> Sequence[int]:
    """Where the list of each row begins, and where the last one ends.

    Raises:
        ValueError: there are more or fewer counts than rows.
    """
    if isinstance(counts, int):
        return range(0, (count + 1) * counts, counts) if counts else [0] * (count + 1)
    if len(counts) != count:
        raise ValueError(f"counts: expected {count}, found {len(counts)}")
    starts = [0]
    for one in counts if isinstance(counts, list) else np.asarray(counts).tolist():
        starts.append(starts[-1] + one)
    return starts


empty_list = _fixed(_LENGTH.size, bytes(_LENGTH.size))
"""No items in any row."""


def lists(sources: Sequence[tuple[Sequence[int], Step]]) -> Step:
    """Of each row its items of each source; where those of each row begin is given, and what appends one."""

    def append(out: bytearray, row: int) -> None:
        out += _COUNTS[len(out) % ALIGNMENT]
        total = 0
        for starts, _ in sources:
            total += starts[row + 1] - starts[row]
        out += _LENGTH.pack(total)
        for starts, append_one in sources:
            for one in range(starts[row], starts[row + 1]):
                append_one(out, one)

    return append


def number_lists(starts: Sequence[int], code: str, width: int, values: Array) -> Step:
    """Lists of items of `width` numbers.

    Raises:
        ValueError: the array does not fit.
    """
    if values.shape != (starts[-1], width) and (width != 1 or values.shape != (starts[-1],)):
        raise ValueError(f"an array: expected {(starts[-1], width)} values, found {values.shape}")
    length, data = _SIZES[code] * width, memoryview(_as_bytes(values, code))
    padding = _PADDING[_SIZES[code]]

    def append(out: bytearray, row: int) -> None:
        first, last = starts[row], starts[row + 1]
        out += _COUNTS[len(out) % ALIGNMENT]
        out += _LENGTH.pack(last - first)
        if last > first:
            out += padding[len(out) % ALIGNMENT]
            out += data[first * length : last * length]

    return append


def _as_bytes(values: Array, code: str) -> bytes:
    kind = _KINDS[code]
    cast = values.astype(kind)
    if kind.kind in "iu" and not np.can_cast(values.dtype, kind) and not (cast == values).all():
        raise ValueError(f"an array: a number does not fit into {kind.name}")
    return cast.tobytes()


def _encoded(text: str) -> bytes:
    encoded = text.encode()
    return _LENGTH.pack(len(encoded) + 1) + encoded + b"\0"


_KINDS = {code: np.dtype(f"<{code}") for code in "?bBhHiIqQfd"}
_SIZES = {code: kind.itemsize for code, kind in _KINDS.items()}
