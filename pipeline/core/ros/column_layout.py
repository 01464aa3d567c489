"""The layout of columns, for the compiled pass that puts their rows together (`column_kernels`)."""

import struct
from array import array
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from itertools import accumulate
from typing import Any

import numpy as np

from pipeline.core.arrays import I64, U8, Array
from pipeline.core.ros.cdr import CODES
from pipeline.core.ros.column_kernels import BYTES, ITEMS, NUMBERS, PART, SOURCE, TEXTS

__all__ = ["SIZES", "Layout", "Rows", "starts_of"]

_LENGTH = struct.Struct("<I")  # of texts and lists
_NO_TEXT = _LENGTH.pack(1) + b"\0"
_ZEROS = bytes(64)
_KINDS = {code: np.dtype(f"<{code}") for code in CODES.values()}
SIZES = {code: kind.itemsize for code, kind in _KINDS.items()}
"""Bytes of a number, by its code: it is aligned to as many."""

Lines = list[int]
"""Lines of a layout, five numbers each."""


class Layout:
    """Where the bytes of fields lie, and these bytes; empty texts and zeros come first."""

    def __init__(self) -> None:
        self.lines: Lines = []
        self.starts: list[int] = []
        self._data = [_NO_TEXT, _ZEROS]
        self._size = len(_NO_TEXT) + len(_ZEROS)

    @property
    def arrays(self) -> tuple[I64, I64, U8]:
        """`layout`, `starts` and `data` of `column_kernels`."""
        lines, starts = (np.frombuffer(array("q", numbers), np.int64) for numbers in (self.lines, self.starts))
        return lines.reshape(-1, 5), starts, np.frombuffer(b"".join(self._data), np.uint8)

    def keep(self, data: bytes) -> int:
        """Keep bytes of a field; where they begin."""
        place = self._size
        self._data.append(data)
        self._size += len(data)
        return place

    def keep_starts(self, starts: Sequence[int]) -> int:
        """Keep where each row begins; where the first one's is found."""
        place = len(self.starts)
        self.starts += starts
        return place


class Rows:
    """The layout of messages, as it grows field by field.

    Args:
        layout: Gets it.
        count: The number of messages.

    Attributes:
        layout: The same.
        count: The same.
        lines: What it is so far.
    """

    def __init__(self, layout: Layout, count: int) -> None:
        self.layout, self.count = layout, count
        self.lines: Lines = []

    def end(self) -> tuple[int, int]:
        """Where the layout begins, and where it ends."""
        lines = self.layout.lines
        first = len(lines) // 5
        lines += self.lines
        return first, len(lines) // 5

    def add_numbers(self, code: str, width: int, value: Any) -> None:
        """Add `width` numbers: an array (N, width), a tuple for all rows, or zeros; of one number (N,) or itself.

        Raises:
            struct.error: a number does not fit.
            ValueError: an array does not.
        """
        size = SIZES[code]
        length = size * width
        if isinstance(value, np.ndarray):
            if value.shape != (self.count, width) and (width != 1 or value.shape != (self.count,)):
                raise ValueError(f"an array: expected {(self.count, width)} values, found {value.shape}")
            self.lines += BYTES, size, self.layout.keep(_as_bytes(value, code)), length, length
        elif value is None:
            for start in range(0, length, len(_ZEROS)):
                self.lines += BYTES, size, len(_NO_TEXT), min(length - start, len(_ZEROS)), 0
        else:
            pack = _packer(code, width)
            self.add_bytes(size, pack(*value) if isinstance(value, tuple) else pack(value))

    def add_texts(self, value: str | Sequence[str] | None) -> None:
        """Add one text for all rows, or one for each.

        Raises:
            ValueError: there are more or fewer.
        """
        if value is None:
            self.lines += BYTES, _LENGTH.size, 0, len(_NO_TEXT), 0
        elif isinstance(value, str):
            self.add_bytes(_LENGTH.size, _encoded(value))
        else:
            if len(value) != self.count:
                raise ValueError(f"texts: expected {self.count}, found {len(value)}")
            encoded = [*map(_encoded, value)]
            place = self.layout.keep(b"".join(encoded))
            starts = self.layout.keep_starts([*accumulate(map(len, encoded), initial=place)])
            self.lines += TEXTS, _LENGTH.size, starts, 0, 0

    def add_bytes(self, alignment: int, data: bytes) -> None:
        """Add bytes that are the same for all rows."""
        self.lines += BYTES, alignment, self.layout.keep(data), len(data), 0

    def add_part(self, part: tuple[int, int]) -> None:
        """Add a message that is the same for all rows, by where its layout begins and ends."""
        self.lines += PART, 1, *part, 0

    def add_empty_list(self) -> None:
        """Add a list without items."""
        self.lines += BYTES, _LENGTH.size, len(_NO_TEXT), _LENGTH.size, 0

    def add_lists(self, sources: Sequence[tuple[tuple[int, int], Sequence[int]]]) -> None:
        """Add a list of messages: where the layout of those of each source begins and ends, and where each row's do."""
        self.lines += ITEMS, _LENGTH.size, len(sources), 0, 0
        for part, starts in sources:
            self.lines += SOURCE, 1, *part, self.layout.keep_starts(starts)

    def add_number_lists(self, code: str, width: int, values: Array, starts: Sequence[int]) -> None:
        """Add a list of items of `width` numbers.

        Raises:
            ValueError: the array does not fit.
        """
        if values.shape != (starts[-1], width) and (width != 1 or values.shape != (starts[-1],)):
            raise ValueError(f"an array: expected {(starts[-1], width)} values, found {values.shape}")
        size, place = SIZES[code], self.layout.keep(_as_bytes(values, code))
        self.lines += NUMBERS, size, place, size * width, self.layout.keep_starts(starts)


def starts_of(counts: Array | Sequence[int] | int, count: int) -> Sequence[int]:
    """Where the list of each row begins, and where the last one ends.

    Raises:
        ValueError: there are more or fewer counts than rows.
    """
    if isinstance(counts, int):
        return range(0, (count + 1) * counts, counts) if counts else [0] * (count + 1)
    if len(counts) != count:
        raise ValueError(f"counts: expected {count}, found {len(counts)}")
    return [*accumulate(counts if isinstance(counts, list) else np.asarray(counts).tolist(), initial=0)]


@cache
def _packer(code: str, width: int) -> Callable[..., bytes]:
    return struct.Struct(f"<{width}{code}").pack


@lru_cache(maxsize=4096)  # most are names
def _encoded(text: str) -> bytes:
    encoded = text.encode()
    return _LENGTH.pack(len(encoded) + 1) + encoded + b"\0"


def _as_bytes(values: Array, code: str) -> bytes:
    kind = _KINDS[code]
    if values.dtype is kind:
        return values.tobytes()
    cast = values.astype(kind)
    if kind.kind in "iu" and not np.can_cast(values.dtype, kind) and not (cast == values).all():
        raise ValueError(f"an array: a number does not fit into {kind.name}")
    return cast.tobytes()
