"""Rows of columns as little-endian CDR, put together in one compiled pass.

A layout (L, 5) says of each field what it is and where its bytes lie: kind, the bytes that it is aligned to, and

- `BYTES`: the place of the first row's in `data`, their number, and that from each row's to the next one's, or 0;
- `TEXTS`: where the places in `data` at which those of each row begin lie in `starts`;
- `NUMBERS`, a list of them: place, bytes of an item, and where the first item of each row lies in `starts`;
- `ITEMS`, the number of messages in a list: the number of `SOURCE`s that follow;
- `SOURCE`: the first and the last line of its messages' layout, the last one not included, and where the first message
  of each row lies in `starts`;
- `PART`, a message that is the same for all rows: the first and the last line of its layout.
"""

import numpy as np

from pipeline.core.arrays import I64, U8
from pipeline.core.compiled import compiled, inlined

__all__ = ["BYTES", "ITEMS", "NUMBERS", "PART", "SOURCE", "TEXTS", "encoded_rows"]

BYTES, TEXTS, NUMBERS, ITEMS, SOURCE, PART = range(6)


@inlined
def _aligned(out: U8, end: int, origin: int, alignment: int) -> int:
    """The end of the bytes, once they are filled up with zeros for what follows."""
    filled = end + (origin - end) % alignment
    for place in range(end, min(filled, len(out))):
        out[place] = 0
    return filled


@inlined
def _copied(out: U8, end: int, data: U8, place: int, length: int) -> int:
    """The end of the bytes, with those that are copied behind them."""
    if end + length <= len(out):
        for index in range(length):
            out[end + index] = data[place + index]
    return end + length


@inlined
def _counted(out: U8, end: int, origin: int, count: int) -> int:
    """The end of the bytes, with a number of 32 bits behind them."""
    end = _aligned(out, end, origin, 4)
    if end + 4 <= len(out):
        for index in range(4):
            out[end + index] = (count >> (8 * index)) & 255
    return end + 4


_ROWS, _TABLE, _DATA = "Array(int64, 1, 'C', True)", "Array(int64, 2, 'C', True)", "Array(uint8, 1, 'C', True)"


@compiled(f"int64[::1]({_TABLE}, {_ROWS}, {_DATA}, {_TABLE}, int64, uint8[::1])")
def encoded_rows(layout: I64, starts: I64, data: U8, messages: I64, head: int, out: U8) -> I64:
    """Write messages one after another; what there is no room for is counted, but not written.

    Args:
        layout: As above.
        starts: As above.
        data: As above.
        messages: (T, 3) first and last line of the layout of messages of each type, the last one not included, and
            their number.
        head: Bytes before each of them, which are left alone; alignment is counted from their end.
        out: Gets the bytes.

    Returns:
        (N,) where each message ends.
    """
    ends, end, most = np.zeros(messages[:, 2].sum(), np.int64), 0, len(layout) + 1
    begin, stop, line = np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most, np.int64)
    row, rows = np.zeros(most, np.int64), np.zeros(most, np.int64)  # of the message and those that it is in
    done = 0
    for first, last, count in messages:
        for message in range(count):
            end += head
            origin, depth = end, 0
            begin[0], stop[0], line[0], row[0], rows[0] = first, last, first, message, message + 1
            while depth >= 0:
                if line[depth] == stop[depth]:
                    row[depth] += 1
                    line[depth] = begin[depth]
                    if row[depth] == rows[depth]:
                        depth -= 1
                    continue
                at, here = line[depth], row[depth]
                line[depth] += 1
                kind, alignment, place, length, more = layout[at]
                if kind == BYTES:
                    place += here * more
                elif kind == TEXTS:
                    place, length = starts[place + here], starts[place + here + 1] - starts[place + here]
                elif kind in (NUMBERS, ITEMS):
                    number = 0
                    for source in range(at, at + 1) if kind == NUMBERS else range(at + 1, at + 1 + place):
                        number += starts[layout[source, 4] + here + 1] - starts[layout[source, 4] + here]
                    end = _counted(out, end, origin, number)
                    if kind == NUMBERS:
                        place, length = place + starts[more + here] * length, length * number
                if kind <= NUMBERS and length:
                    end = _copied(out, _aligned(out, end, origin, alignment), data, place, length)
                elif kind >= SOURCE:
                    first_row, last_row = (0, 1) if kind == PART else (starts[more + here], starts[more + here + 1])
                    if last_row > first_row:
                        depth += 1
                        begin[depth], stop[depth], line[depth] = place, length, place
                        row[depth], rows[depth] = first_row, last_row
            ends[done] = end
            done += 1
    return ends
