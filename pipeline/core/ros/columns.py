"""Many messages of one type as columns, a value or an array for each field; `column_encoder` makes their bytes.

Where a frame has some dozens of objects, a message object for each of them and for each point, colour and time within
takes most of the time of writing. Of columns only the bytes are made (`core.ros.cdr` encodes message objects).
"""

from collections.abc import Sequence
from typing import Any

from pipeline.core.arrays import Array

__all__ = ["Columns", "Lists"]


class Columns:
    """Messages of one type.

    What a field is given as: a number or a text of all messages; (N,) numbers or texts; of messages or arrays of K
    numbers of one type, a tuple (K,) or an array (N, K); of other messages `Columns`, of N rows or of one for all, or
    the bytes that they all have if nothing in them is aligned to more than their beginning is; of sequences `Lists`.
    What is left out is zero or empty.

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
