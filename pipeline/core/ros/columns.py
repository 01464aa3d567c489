"""Many messages of one type as columns, a value or an array for each field, and their bytes as little-endian CDR.

Where a frame has some dozens of objects, a message object for each of them and for each point, colour and time within
takes most of the time of writing. Of columns only the bytes are made (`core.ros.cdr` encodes message objects).
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from pipeline.core.arrays import Array
from pipeline.core.ros.cdr import CODES, HEAD
from pipeline.core.ros.column_steps import (
    Step,
    all_of,
    empty_list,
    lists,
    number_lists,
    numbers,
    same_for_all,
    starts_of,
    texts,
)

__all__ = ["Columns", "ColumnsEncoder", "Lists"]

Bind = Callable[[Any, int], Step]
"""What appends a field, from its value and the number of rows."""


class Columns:
    """Messages of one type.

    What a field is given as: a number or a text of all messages; (N,) numbers or texts; of messages or arrays of K
    numbers of one type, a tuple (K,) or an array (N, K); of other messages `Columns`, of N rows or of one for all; of
    sequences `Lists`. What is left out is zero or empty.

    Attributes:
        count: The number of messages, N.
        fields: By name.
    """

    def __init__(self, msgtype: str, count: int = 1, /, **fields: Any) -> None:
        self.__msgtype__ = msgtype  # as rosbags' messages call it
        self.count, self.fields = count, fields


class Lists:
    """A sequence of messages, or of numbers, for each row.

    Attributes:
        rows: All of them, row after row; of messages of K numbers of one type an array (M, K) will do.
        counts: (N,) how many each row has, or the number that every row has.
        then: What follows them in each row, where all are `Columns`.
    """

    def __init__(
        self, rows: Columns | Array, counts: Array | Sequence[int] | int = 1, then: "Lists | None" = None
    ) -> None:
        self.rows, self.counts, self.then = rows, counts, then


class ColumnsEncoder:
    """Encodes columns of the types of a store.

    Args:
        store: Knows the types.
    """

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._plans: dict[tuple[str, ...], Sequence[tuple[str, Bind]]] = {}
        self._uniform: dict[str, tuple[str, int]] = {}

    def encode(self, columns: Columns) -> list[memoryview]:
        """The bytes of each message.

        Raises:
            struct.error: a number does not fit its field.
            ValueError: an array, a number of texts or a type does not.
            LookupError: there is no such field.
        """
        append, found = self._of(columns), []
        for row in range(columns.count):
            out = bytearray(HEAD)
            append(out, row)
            found.append(memoryview(out).toreadonly())
        return found

    def _of(self, columns: Columns) -> Step:
        """What appends a message."""
        key = columns.__msgtype__, *columns.fields
        if key not in self._plans:
            self._plans[key] = self._plan(columns.__msgtype__, {*columns.fields})
        fields, count = columns.fields, columns.count
        return all_of([bind(fields.get(name), count) for name, bind in self._plans[key]])

    def _plan(self, msgtype: str, given: set[str]) -> Sequence[tuple[str, Bind]]:
        """The fields in their order, with those that follow each other and are not given as one."""
        known = self._store.get_msgdef(msgtype).fields
        if unknown := given - {name for name, _ in known}:
            raise LookupError(f"{msgtype} has no {', '.join(sorted(unknown))}")
        plan: list[tuple[str, Bind]] = []
        empty: list[Step] = []
        for name, kind in known:
            bind = self._bind(kind)
            if name not in given:
                empty.append(bind(None, 1))
                continue
            plan += _made(empty)
            empty = []
            plan.append((name, bind))
        return plan + _made(empty)

    def _bind(self, kind: Any) -> Bind:
        if kind[0] == Nodetype.NAME:
            return partial(self._message, kind[1])
        if kind[0] == Nodetype.SEQUENCE:
            return partial(self._sequence, kind[1][0])
        if kind[0] == Nodetype.BASE and kind[1][0] == "string":
            return texts
        (what, width) = (kind[1][0], 1) if kind[0] == Nodetype.BASE else (kind[1][0][1][0], kind[1][1])
        return partial(numbers, CODES[what], width)

    def _message(self, msgtype: str, value: Any, count: int) -> Step:
        """What appends the message within each row."""
        if value is None:
            return self._of(Columns(msgtype))
        if not isinstance(value, Columns):
            return numbers(*self._uniform_type(msgtype), value, count)
        _checked(value, msgtype)
        if value.count == 1 and count != 1:
            return same_for_all(self._of(value))
        if value.count != count:
            raise ValueError(f"{msgtype}: expected {count} rows, found {value.count}")
        return self._of(value)

    def _sequence(self, of: Any, value: Lists | None, count: int) -> Step:
        if value is None:
            return empty_list
        if isinstance(value.rows, Columns):
            return lists([*self._sources(of[1], value, count)])
        code, width = self._uniform_type(of[1]) if of[0] == Nodetype.NAME else (CODES[of[1][0]], 1)
        return number_lists(starts_of(value.counts, count), code, width, value.rows)

    def _sources(self, msgtype: str, value: Lists | None, count: int) -> Iterator[tuple[Sequence[int], Step]]:
        """Where the messages of each row begin, and what appends one; of what follows them, too."""
        while value is not None:
            starts = starts_of(value.counts, count)
            rows = _checked(value.rows, msgtype)
            if rows.count != starts[-1]:
                raise ValueError(f"{msgtype}: expected {starts[-1]} rows, found {rows.count}")
            if rows.count:
                yield starts, self._of(rows)
            value = value.then

    def _uniform_type(self, msgtype: str) -> tuple[str, int]:
        """Of a message of numbers of one type alone, their code and their number."""
        if msgtype not in self._uniform:
            found = [*self._numbers(msgtype)]
            if len({code for code, _ in found}) != 1 or not found[0][0]:
                raise ValueError(f"{msgtype}: expected columns, as it does not hold numbers of one type alone")
            self._uniform[msgtype] = found[0][0], sum(width for _, width in found)
        return self._uniform[msgtype]

    def _numbers(self, msgtype: str) -> Iterator[tuple[str, int]]:
        """Code and number of the numbers of each field; no code for other fields."""
        for _, kind in self._store.get_msgdef(msgtype).fields:
            if kind[0] == Nodetype.NAME:
                yield from self._numbers(kind[1])
            elif kind[0] == Nodetype.BASE:
                yield CODES.get(kind[1][0], ""), 1
            elif kind[0] == Nodetype.ARRAY and kind[1][0][0] == Nodetype.BASE:
                yield CODES.get(kind[1][0][1][0], ""), kind[1][1]
            else:
                yield "", 0


def _made(empty: Sequence[Step]) -> list[tuple[str, Bind]]:
    """Fields without values as one, which is the same for all rows."""
    if not empty:
        return []
    step = same_for_all(all_of(empty))
    return [("", lambda _value, _count: step)]


def _checked(columns: Any, msgtype: str) -> Columns:
    found = getattr(columns, "__msgtype__", type(columns).__name__)
    if not isinstance(columns, Columns) or found != msgtype:
        raise ValueError(f"expected columns of {msgtype}, found {found}")
    return columns
