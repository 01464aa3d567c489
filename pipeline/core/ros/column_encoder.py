"""Encodes columns as little-endian CDR: notes where the bytes of each field lie, then puts all rows together."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import groupby, islice
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from pipeline.core.ros.cdr import CODES, HEAD
from pipeline.core.ros.column_kernels import encoded_rows
from pipeline.core.ros.column_layout import SIZES, Layout, Rows, starts_of
from pipeline.core.ros.columns import Columns, Lists

__all__ = ["ColumnsEncoder"]

AddField = Callable[[Rows, Any], None]
"""Adds a field to the layout of rows, from its value."""


class ColumnsEncoder:
    """Encodes columns of the types of a store.

    Args:
        store: Knows the types.
    """

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._plans: dict[tuple[str, ...], Sequence[tuple[str, AddField]]] = {}
        self._uniform: dict[str, tuple[str, int]] = {}
        self._alignments: dict[str, int] = {}
        self._room = np.zeros(1 << 14, np.uint8)

    def encode(self, *columns: Columns) -> list[list[bytes]]:
        """The bytes of each message, of each columns; to encode many at once is quicker.

        Raises:
            struct.error: a number does not fit its field.
            ValueError: an array, a number of texts or a type does not.
            LookupError: there is no such field.
        """
        layout = Layout()
        messages = np.array([(*self._rows(layout, one), one.count) for one in columns], np.int64).reshape(-1, 3)
        arrays = layout.arrays
        ends = encoded_rows(*arrays, messages, len(HEAD), self._room)
        if len(ends) and ends[-1] > len(self._room):
            self._room = np.zeros(2 * ends[-1], np.uint8)
            ends = encoded_rows(*arrays, messages, len(HEAD), self._room)
        begin, found = 0, []
        for end in ends.tolist():
            found.append(HEAD + self._room[begin + len(HEAD) : end].tobytes())
            begin = end
        each = iter(found)
        return [[*islice(each, one.count)] for one in columns]

    def _rows(self, layout: Layout, columns: Columns) -> tuple[int, int]:
        """Where the layout of a message begins and ends, behind that of those within it."""
        rows = Rows(layout, columns.count)
        self._add_fields(rows, columns)
        return rows.end()

    def _add_fields(self, rows: Rows, columns: Columns) -> None:
        fields = columns.fields
        key = columns.__msgtype__, *fields
        if key not in self._plans:
            self._plans[key] = self._plan(columns.__msgtype__, {*fields})
        for name, add in self._plans[key]:
            add(rows, fields.get(name))

    def _plan(self, msgtype: str, given: set[str]) -> Sequence[tuple[str, AddField]]:
        """The fields in their order; those that follow each other and are not given as one, always the same."""
        known = self._store.get_msgdef(msgtype).fields
        if unknown := given - {name for name, _ in known}:
            raise LookupError(f"{msgtype} has no {', '.join(sorted(unknown))}")
        plan: list[tuple[str, AddField]] = []
        for is_given, group in groupby(known, lambda field: field[0] in given):
            fields = [(name, self._field(kind)) for name, kind in group]
            plan += fields if is_given else [("", _empty([add for _, add in fields]))]
        return plan

    def _field(self, kind: Any) -> AddField:
        if kind[0] == Nodetype.NAME:
            return partial(self._add_message, kind[1])
        if kind[0] == Nodetype.SEQUENCE:
            return partial(self._add_list, kind[1][0])
        if kind[0] == Nodetype.BASE and kind[1][0] == "string":
            return Rows.add_texts
        (what, width) = (kind[1][0], 1) if kind[0] == Nodetype.BASE else (kind[1][0][1][0], kind[1][1])
        return partial(_add_numbers, CODES[what], width)

    def _add_message(self, msgtype: str, rows: Rows, value: Any) -> None:
        """Add the message within each row."""
        if value is None:
            self._add_fields(rows, Columns(msgtype))
        elif isinstance(value, bytes):
            rows.add_bytes(self._alignment(msgtype), value)
        elif not isinstance(value, Columns):
            rows.add_numbers(*self._uniform_type(msgtype), value)
        elif _checked(value, msgtype).count == rows.count:
            self._add_fields(rows, value)
        elif value.count == 1:
            rows.add_part(self._rows(rows.layout, value))
        else:
            raise ValueError(f"{msgtype}: expected {rows.count} rows, found {value.count}")

    def _add_list(self, of: Any, rows: Rows, value: Lists | None) -> None:
        if value is None:
            rows.add_empty_list()
        elif isinstance(value.rows, Columns):
            rows.add_lists([*self._sources(of[1], rows, value)])
        else:
            code, width = self._uniform_type(of[1]) if of[0] == Nodetype.NAME else (CODES[of[1][0]], 1)
            rows.add_number_lists(code, width, value.rows, starts_of(value.counts, rows.count))

    def _sources(
        self, msgtype: str, rows: Rows, value: Lists | None
    ) -> Iterator[tuple[tuple[int, int], Sequence[int]]]:
        """The layout of the messages of each row, and where those of each row begin; of what follows them, too."""
        while value is not None:
            starts = starts_of(value.counts, rows.count)
            items = _checked(value.rows, msgtype)
            if items.count != starts[-1]:
                raise ValueError(f"{msgtype}: expected {starts[-1]} rows, found {items.count}")
            if items.count:
                yield self._rows(rows.layout, items), starts
            value = value.then

    def _uniform_type(self, msgtype: str) -> tuple[str, int]:
        """Of a message of numbers of one type alone, their code and their number."""
        if msgtype not in self._uniform:
            found = [*self._numbers(msgtype)]
            if len({code for code, _ in found}) != 1 or not found[0][0]:
                raise ValueError(f"{msgtype}: expected columns, as it does not hold numbers of one type alone")
            self._uniform[msgtype] = found[0][0], sum(width for _, width in found)
        return self._uniform[msgtype]

    def _alignment(self, msgtype: str) -> int:
        """Of a message whose bytes are the same wherever it may begin, what it is aligned to."""
        if msgtype not in self._alignments:
            found = [8 if code is None else SIZES.get(code, SIZES["I"]) for code, _ in self._numbers(msgtype)]
            if found[0] != max(found):
                raise ValueError(f"{msgtype}: expected columns, as its bytes depend on what is before it")
            self._alignments[msgtype] = found[0]
        return self._alignments[msgtype]

    def _numbers(self, msgtype: str) -> Iterator[tuple[str | None, int]]:
        """Code and number of the numbers of each field; no code for texts, and None for lists and arrays of others."""
        for _, kind in self._store.get_msgdef(msgtype).fields:
            if kind[0] == Nodetype.NAME:
                yield from self._numbers(kind[1])
            elif kind[0] == Nodetype.BASE:
                yield CODES.get(kind[1][0], ""), 1
            elif kind[0] == Nodetype.ARRAY and kind[1][0][0] == Nodetype.BASE:
                yield CODES.get(kind[1][0][1][0], ""), kind[1][1]
            else:
                yield None, 0


def _empty(fields: Sequence[AddField]) -> AddField:
    """Adds fields that are not given, which have the same layout in all messages."""
    rows = Rows(Layout(), 1)
    for add in fields:
        add(rows, None)
    lines = rows.lines
    return lambda rows, _value: rows.lines.extend(lines)


def _add_numbers(code: str, width: int, rows: Rows, value: Any) -> None:
    rows.add_numbers(code, width, value)


def _checked(columns: Any, msgtype: str) -> Columns:
    if not isinstance(columns, Columns) or columns.__msgtype__ != msgtype:
        found = getattr(columns, "__msgtype__", type(columns).__name__)
        raise ValueError(f"expected columns of {msgtype}, found {found}")
    return columns
