"""What a compiled function uses: functions and numbers, of its own file and of others."""

import inspect
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numpy as np

__all__ = ["MADE_BY", "parts", "used"]

MADE_BY = "_made_by"
"""Attribute of functions for which something else stands: what makes it."""

_NUMBERS = (int, float, np.generic, tuple)


def parts(function: FunctionType) -> dict[str, FunctionType]:
    """The functions that it calls, by the names that they have in its file."""
    return {name: value for name, value in _globals(function) if isinstance(value, FunctionType)}


def used(function: FunctionType) -> bytes:
    """What its machine code depends on beside the text of its own file.

    Texts of the files with the functions that it calls, with those that these call, and with what makes any of them;
    and the numbers that they name.

    Raises:
        OSError: a file cannot be read.
    """
    numbers: set[str] = set()
    seen, waiting = {function}, [function]
    while waiting:
        one = waiting.pop()
        numbers |= {f"{name}={value!r}" for name, value in _globals(one) if isinstance(value, _NUMBERS)}
        plain = {inspect.unwrap(part) for part in [*parts(one).values(), *_makers(one)]} - seen
        seen |= plain
        waiting += plain
    files = {one.__code__.co_filename for one in seen} - {function.__code__.co_filename}
    return b"\0".join(
        [*(number.encode() for number in sorted(numbers)), *(Path(f).read_bytes() for f in sorted(files))]
    )


def _makers(function: FunctionType) -> list[FunctionType]:
    """What makes what stands for it, and the functions that this encloses."""
    make = vars(function).get(MADE_BY)
    if make is None:
        return []
    enclosed = [cell.cell_contents for cell in make.__closure__ or ()]
    return [one for one in [make, *enclosed] if isinstance(one, FunctionType)]


def _globals(function: FunctionType) -> Iterator[tuple[str, Any]]:
    known = function.__globals__
    return ((name, known[name]) for name in sorted(_names(function.__code__)) if name in known)


def _names(code: CodeType) -> set[str]:
    """Names in it and in what it contains, such as comprehensions."""
    return {*code.co_names}.union(*(_names(inner) for inner in code.co_consts if isinstance(inner, CodeType)))
