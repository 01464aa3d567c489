"""Functions compiled for this processor: loops over points that no array operation does in one pass.

numba compiles them, without a compiler on the machine. The first use on a machine takes some seconds per file; what it
makes is kept beside the source, or in the user's cache where that cannot be written (`NUMBA_CACHE_DIR` names another
place). Where nothing can be kept, each process compiles anew.

Rules for such functions, so that every machine makes the same bytes:

- No fast-math, no parallel loops: sums run in the written order, and no product is fused with a sum.
- No sine, exponential or the like where a decision depends on it: they differ in the last bit between machines.
- They call only functions of their own file: what is kept is not made anew when another file changes.
- Their files are imported where a stage is built, never for `--help`: numba takes a third of a second.
"""

import logging
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

__all__ = ["compile_log", "compiled", "inlined"]

P = ParamSpec("P")
R = TypeVar("R")

compile_log = logging.getLogger("pipeline.compiled")
"""What is compiled because it was not kept, at level INFO: it may take a while, once."""

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "boundscheck": False, "fastmath": False}

_told = False


def compiled(*signatures: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function for the given types of arguments, or take what an earlier process made.

    It runs without the interpreter's lock. Arguments of other types raise TypeError. An index beyond the end of an
    array is not checked, and a negative one counts from the end, as in numpy.

    Args:
        signatures: As numba writes them, such as "float32[::1](float32[:, ::1], int64)"; at least one.
    """

    def compiling(function: Callable[P, R]) -> Callable[P, R]:
        import numba

        if vars(numba.config)["DISABLE_JIT"]:  # for a debugger
            return function
        try:
            return _made(numba.njit(cache=True, **_OPTIONS)(function), function, signatures)
        except (OSError, RuntimeError) as err:
            if not _is_about_the_cache(err):
                raise
            return _made(numba.njit(**_OPTIONS)(function), function, signatures)

    return compiling


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A part of compiled functions of the same file, for any types of arguments."""
    import numba

    return cast("Callable[P, R]", numba.njit(inline="always", **_OPTIONS)(function))


def _made(dispatcher: Any, function: Callable[P, R], signatures: tuple[str, ...]) -> Callable[P, R]:
    started = time.perf_counter()
    if not _is_kept(dispatcher, function):
        _tell()
    for signature in signatures:
        dispatcher.compile(signature)
    dispatcher.disable_compile()
    if not dispatcher.stats.cache_hits:
        compile_log.debug("%s compiled in %.1f s", function.__qualname__, time.perf_counter() - started)
    return cast("Callable[P, R]", dispatcher)


def _is_kept(dispatcher: Any, function: Callable[..., Any]) -> bool:
    """Whether an earlier process seems to have made it; a kept file may be of another version."""
    folder = dispatcher.stats.cache_path
    with suppress(OSError):
        return folder is not None and any(Path(folder).glob(f"*.{function.__qualname__}-*.nbi"))
    return False


def _is_about_the_cache(err: Exception) -> bool:
    return isinstance(err, OSError) or "cannot cache function" in str(err)


def _tell() -> None:
    global _told
    if not _told:
        _told = True
        compile_log.info("compiling for this processor, once: up to half a minute")
