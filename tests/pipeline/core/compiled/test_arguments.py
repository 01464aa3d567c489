"""Which arguments machine code is called with."""

from typing import Any

import numpy as np
import pytest

from pipeline.core.compiled.arguments import checked
from pipeline.core.compiled.machine_code import Argument

TABLE = Argument("array", "<f4", 2, 0x101)
WRITTEN = Argument("array", "<f4", 2, 0x501)
ANY_ORDER = Argument("array", "<f4", 2, 0x100)
INTEGER, REAL, BOOLEAN = Argument("integer"), Argument("real"), Argument("boolean")

table = np.zeros((2, 3), np.float32)
fixed = np.zeros((2, 3), np.float32)
fixed.flags.writeable = False
unaligned = np.frombuffer(bytes(25), np.uint8)[1:].view(np.float32).reshape(2, 3)


def call(argument: Argument, value: Any) -> Any:
    return checked(lambda *values: values, [argument], "f")(value)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        (TABLE, table),
        (TABLE, fixed),
        (TABLE, np.zeros((0, 3), np.float32)),
        (WRITTEN, table),
        (ANY_ORDER, table.T),
        (INTEGER, 1),
        (INTEGER, np.int32(1)),
        (REAL, 1),
        (REAL, np.float32(1)),
        (BOOLEAN, True),
        (BOOLEAN, np.True_),
    ],
)
def test_taken(argument: Argument, value: Any) -> None:
    assert call(argument, value)[0] is value


@pytest.mark.parametrize(
    ("argument", "value", "told"),
    [
        (TABLE, table.T, "float32 array of 2 dimensions F writable"),
        (TABLE, table.astype(float), "float64 array of 2 dimensions C writable"),
        (TABLE, table.astype(">f4"), ">f4 array|float32 array"),
        (TABLE, table[0], "float32 array of 1 dimensions"),
        (TABLE, table[:, ::2], "float32 array of 2 dimensions writable"),
        (TABLE, unaligned, "float32 array of 2 dimensions C"),
        (TABLE, table.tolist(), "list"),
        (WRITTEN, fixed, "float32 array of 2 dimensions C"),
        (INTEGER, 1.0, "float"),
        (INTEGER, "1", "str"),
        (REAL, None, "NoneType"),
        (BOOLEAN, 1, "int"),
    ],
)
def test_refused(argument: Argument, value: Any, told: str) -> None:
    with pytest.raises(TypeError, match=f"f: expected .*, got .({told})"):
        call(argument, value)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_another_number_of_arguments_is_refused(count: int) -> None:
    with pytest.raises(TypeError, match=r"f: expected \(integer, real\), got"):
        checked(lambda *values: values, [INTEGER, REAL], "f")(*[1] * count)
