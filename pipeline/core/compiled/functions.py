"""The decorators of compiled functions and of their parts."""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, update_wrapper
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import Any, ParamSpec, TypeVar, cast

from pipeline.core.compile_log import compile_log
from pipeline.core.compiled.arguments import checked
from pipeline.core.compiled.beside import start_others
from pipeline.core.compiled.compiling import (
    OPTIONS,
    STANDS_FOR,
    UnknownCodeError,
    dispatcher,
    inner,
    is_kept_by_numba,
    machine_code,
)
from pipeline.core.compiled.kept import Keeper
from pipeline.core.compiled.linking import LinkError, link, made_for
from pipeline.core.compiled.parts import MADE_BY, used

__all__ = ["compiled", "compiled_as", "inlined"]

P = ParamSpec("P")
R = TypeVar("R")

_told = False


def compiled(signature: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function for the given types of arguments, or take what an earlier process made.

    It runs without the interpreter's lock. Arguments of other types raise TypeError. An index beyond the end of an
    array is not checked, and a negative one counts from the end, as in numpy.

    Args:
        signature: As numba writes it, such as "float32[::1](float32[:, ::1], int64)".
    """

    def making(function: Callable[P, R]) -> Callable[P, R]:
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):  # for a debugger
            return function
        assert isinstance(function, FunctionType)
        made_of = made_for()
        ready = _linked(function, signature, made_of) if made_of else None
        return cast("Callable[P, R]", ready or _by_numba(function, signature))

    return making


def compiled_as(make: Callable[[], Any]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """In compiled functions, something else stands for the decorated function.

    Args:
        make: Makes what numba knows, when something that needs it is compiled; called once. It names the functions that
            it uses, or encloses them, as compiled functions do.
    """

    def deciding(function: Callable[P, R]) -> Callable[P, R]:
        vars(function)[MADE_BY] = make
        return _standing_for(make)(function)

    return deciding


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A part of compiled functions, for any types of arguments."""
    return _standing_for(lambda: inner(function))(function)


def _standing_for(make: Callable[[], Any]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    def deciding(function: Callable[P, R]) -> Callable[P, R]:
        vars(function)[STANDS_FOR] = cache(make)
        return function

    return deciding


def _linked(function: FunctionType, signature: str, made_of: str) -> Callable[..., Any] | None:
    """Machine code, kept or new; nothing if it cannot be run without numba."""
    name = function.__qualname__
    keeper = _keeper(function, f"{made_of}\0{OPTIONS}\0{signature}")
    code, made = keeper.read() if keeper else None, None
    try:
        if code is None:
            _tell()
            started = time.perf_counter()
            made = dispatcher(function, signature, no_cfunc_wrapper=True)
            compile_log.debug("%s compiled in %.1f s", name, time.perf_counter() - started)
            code = machine_code(made)
            if keeper and keeper.write(code):
                start_others()
        call = checked(link(code, name), code.arguments, name)
    except (LinkError, UnknownCodeError) as err:
        compile_log.debug("%s is left to numba: %s", name, err)
        return None
    part = _standing_for(lambda: made or dispatcher(function, signature))
    return part(update_wrapper(call, function))


def _keeper(function: FunctionType, made_of: str) -> Keeper | None:
    if "<" in function.__qualname__:  # a function within another may depend on the place where it was made
        return None
    with suppress(OSError):
        return Keeper(Path(function.__code__.co_filename), function.__qualname__, made_of, used(function))
    return None


def _by_numba(function: FunctionType, signature: str) -> Callable[..., Any]:
    """As numba calls what it made; it keeps that itself, where it can."""
    try:
        # numba looks whether the file of the function has changed, and at its name, but not at what it uses.
        name = f"{function.__qualname__}_{sha256(used(function)).hexdigest()[:16]}"
        if not is_kept_by_numba(function, name):
            _tell()
        return cast("Callable[..., Any]", dispatcher(function, signature, name=name, cache=True))
    except (OSError, RuntimeError) as err:
        if not isinstance(err, OSError) and "cannot cache function" not in str(err):
            raise
        _tell()
        return cast("Callable[..., Any]", dispatcher(function, signature))


def _tell() -> None:
    global _told
    if not _told:
        _told = True
        compile_log.info("compiling for this processor, once: up to a minute")
