"""Whether arguments are of the types that a function was compiled for: machine code takes any bytes for numbers."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pipeline.core.compiled.machine_code import Argument

__all__ = ["checked"]

_SCALARS: dict[str, tuple[type, ...]] = {
    "integer": (int, np.integer, np.bool_),
    "real": (float, int, np.floating, np.integer, np.bool_),
    "boolean": (bool, np.bool_),
}


def checked(call: Callable[..., Any], arguments: Sequence[Argument], name: str) -> Callable[..., Any]:
    """A function that calls another one if its arguments fit.

    It raises TypeError for other types and other numbers of arguments. Whole numbers are taken as real ones.

    Args:
        call: Machine code.
        arguments: What it takes.
        name: Its name, for errors.
    """
    count = len(arguments)
    wanted: list[tuple[Any, ...]] = [
        (None, np.dtype(argument.dtype), argument.ndim, argument.flags)
        if argument.kind == "array"
        else (_SCALARS[argument.kind], None, 0, 0)
        for argument in arguments
    ]

    def calling(*values: Any) -> Any:
        for value, (kinds, dtype, ndim, flags) in zip(values, wanted, strict=False):
            if kinds is not None:
                if not isinstance(value, kinds):
                    break
            elif (
                not isinstance(value, np.ndarray)
                or value.ndim != ndim
                or value.flags.num & flags != flags
                # Of equal types there is mostly one object, and to compare two takes longer than all the rest.
                or (value.dtype is not dtype and value.dtype != dtype)
            ):
                break
        else:
            if len(values) == count:
                return call(*values)
        raise TypeError(
            f"{name}: expected ({', '.join(map(_expected, arguments))}), got ({', '.join(map(_got, values))})"
        )

    return calling


def _expected(argument: Argument) -> str:
    if argument.kind != "array":
        return argument.kind
    return _array(argument.dtype, argument.ndim, argument.flags)


def _got(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return _array(value.dtype.str if value.dtype.isnative else str(value.dtype), value.ndim, value.flags.num)
    return type(value).__name__


def _array(dtype: str, ndim: int, flags: int) -> str:
    words = [word for bit, word in ((1, "C"), (2, "F"), (0x400, "writable")) if flags & bit]
    return " ".join([f"{np.dtype(dtype)} array of {ndim} dimensions", *words])
