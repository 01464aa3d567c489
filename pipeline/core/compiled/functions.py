"""The decorators of compiled functions and of their parts.

numba keeps what it makes in a folder of its own for each version of the sources, since it does not see when a part in
another file changes. Machine code is run as it is read, so the folder has to be the user's own, and nobody else may
write there; otherwise everything is compiled for this run alone.
"""

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba

from pipeline.core.compile_log import compile_log
from pipeline.core.compiled.beside import kernel_sources, one_compiled

__all__ = ["cache_folder", "compiled", "inlined"]

P = ParamSpec("P")
R = TypeVar("R")

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "boundscheck": False, "fastmath": False}


def compiled(signature: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function for the given types of arguments, or take what an earlier process made.

    It runs without the interpreter's lock. Arguments of other types raise TypeError. An index beyond the end of an
    array is not checked, and a negative one counts from the end, as in numpy. With `NUMBA_DISABLE_JIT=1` in the
    environment it stays plain Python, for a debugger.

    Args:
        signature: As numba writes it, such as "float32[::1](float32[:, ::1], int64)".
    """

    def making(function: Callable[P, R]) -> Callable[P, R]:
        made = _made(function, signature)
        if getattr(made, "stats", None) and not made.stats.cache_hits:
            one_compiled(cache_folder())
        return cast("Callable[P, R]", made)

    return making


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A part of compiled functions, for any types of arguments."""
    return cast("Callable[P, R]", numba.njit(inline="always", **OPTIONS)(function))


def _made(function: Callable[..., Any], signature: str) -> Any:
    if (folder := cache_folder()) is not None:
        try:
            with _kept_in(folder):
                return numba.njit(signature, cache=True, **OPTIONS)(function)
        except OSError as err:  # a full disk
            compile_log.debug("%s cannot be kept in %s: %s", function.__qualname__, folder, err)
    return numba.njit(signature, **OPTIONS)(function)


@contextmanager
def _kept_in(folder: Path) -> Iterator[None]:
    """Within the block, numba keeps functions there; what else a user compiles has another place."""
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


@cache
def cache_folder() -> Path | None:
    """Where compiled functions are kept; nothing if that cannot be a folder of the user's own."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    version = sha256(numba.__version__.encode())
    own = [(path, path.read_text(encoding="utf-8")) for path in sorted(Path(__file__).parent.glob("*.py"))]
    for path, text in (*own, *kernel_sources()):
        version.update(f"{path.name}\0{text}\0".encode())
    folder = (Path(named) if named else caches / "lidcam") / f"kernels-{version.hexdigest()[:16]}"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except (OSError, RuntimeError) as err:
        problem = str(err)
    else:
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o022:
            return folder
        problem = "expected a folder of this user that no other can write to"
    compile_log.warning("%s: %s; functions are compiled for this run alone", folder, problem)
    return None
