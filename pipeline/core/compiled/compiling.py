"""What numba does: machine code from functions. It is imported only for that."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from pipeline.core.compiled.machine_code import Argument, MachineCode, undefined_symbols
from pipeline.core.compiled.parts import parts

__all__ = ["OPTIONS", "STANDS_FOR", "UnknownCodeError", "dispatcher", "inner", "is_kept_by_numba", "machine_code"]

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "boundscheck": False, "fastmath": False}

STANDS_FOR = "_compiled_as"
"""Attribute of functions in whose place compiled functions call something else."""


class UnknownCodeError(Exception):
    """Something in what numba made is not understood."""


def dispatcher(function: Callable[..., Any], signature: str, *, name: str = "", **options: Any) -> Any:
    """Compiled by numba, for one type of arguments.

    Args:
        function: May call others that have `STANDS_FOR`.
        signature: As numba writes it.
        name: Under which numba keeps it; that of the function if empty.
        options: Of `numba.njit`, beside `OPTIONS`.
    """
    import numba

    made = numba.njit(**OPTIONS, **options)(_with_compiled_parts(function, name))
    made.compile(signature)
    made.disable_compile()
    return made


def is_kept_by_numba(function: Callable[..., Any], name: str) -> bool:
    """Whether an earlier process seems to have made it; a kept file may be of another version.

    Args:
        function: Any.
        name: Under which numba would keep it.

    Raises:
        RuntimeError: numba finds no place to keep it in.
    """
    import numba

    folder = numba.njit(cache=True)(function).stats.cache_path
    with suppress(OSError):
        return folder is not None and any(Path(folder).glob(f"*.{name}-*.nbi"))
    return False


def inner(function: Callable[..., Any]) -> Any:
    """For numba, a part of compiled functions, for any types of arguments."""
    import numba

    return numba.njit(inline="always", **OPTIONS)(_with_compiled_parts(function))


def machine_code(dispatcher: Any) -> MachineCode:
    """Machine code of what `dispatcher` returned.

    Raises:
        UnknownCodeError: it uses something that cannot be kept.
    """
    import llvmlite.binding as llvm
    from numba.core.environment import lookup_environment

    (result,) = dispatcher.overloads.values()
    _, _, (code, _) = result.library.serialize_using_object_code()
    sections = {section.name(): section.data() for section in llvm.ObjectFileRef.from_data(code).sections()}
    needed, with_room = undefined_symbols(sections[b".symtab"], sections[b".strtab"])
    environments = {}
    for symbol in with_room:
        environment = lookup_environment(symbol)
        if environment is None or not all(isinstance(const, np.dtype) for const in environment.consts):
            raise UnknownCodeError(symbol)
        environments[symbol] = [const.str for const in environment.consts]
    return MachineCode(
        entry=result.fndesc.llvm_cpython_wrapper_name,
        environment=result.environment.env_name,
        environments=environments,
        needed=needed,
        arguments=[_argument(kind) for kind in result.signature.args],
        code=code,
    )


def _argument(kind: Any) -> Argument:
    from numba.core import types
    from numba.np.numpy_support import as_dtype

    if isinstance(kind, types.Array):
        bits = {"C": 0x1, "F": 0x2, "A": 0}[kind.layout] | 0x100 | (0x400 if kind.mutable else 0)
        return Argument("array", as_dtype(kind.dtype).str, kind.ndim, bits)
    for base, name in ((types.Boolean, "boolean"), (types.Integer, "integer"), (types.Float, "real")):
        if isinstance(kind, base):
            return Argument(name)
    raise UnknownCodeError(str(kind))


def _with_compiled_parts(function: Callable[..., Any], name: str = "") -> Callable[..., Any]:
    """The same function, calling compiled ones."""
    assert isinstance(function, FunctionType)
    known = dict(function.__globals__)
    for called, part in parts(function).items():
        known[called] = vars(part).get(STANDS_FOR, lambda part=part: part)()
    same = FunctionType(function.__code__, known, function.__name__, function.__defaults__, function.__closure__)
    same.__qualname__ = name or function.__qualname__
    same.__module__, same.__doc__ = function.__module__, function.__doc__
    return same
