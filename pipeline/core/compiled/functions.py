"""The decorators of compiled functions and of their parts.

numba keeps what it makes in a folder of its own for each version of the sources, since it does not see when a part in
another file changes. Machine code is run as it is read: the folder and what is in it have to be the user's own, and
nobody else may write there or rename a folder above. Otherwise everything is compiled for this run alone.
"""

import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

from lidcam.pipeline.core.compile_log import compile_log
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.text import one_line

SETTINGS_OF_NUMBA = Path(".numba_config.yaml")
"""Which numba reads in the current folder as it is imported."""

try:
    import numba
except Exception as err:
    if not SETTINGS_OF_NUMBA.is_file():
        raise
    told = f"{SETTINGS_OF_NUMBA.absolute()}: expected settings of numba, found {one_line(err)}; mend or remove it"
    raise ConfigError(told) from err

_ROOT = Path(__file__).parents[4]
_IMPORT = "from lidcam.pipeline.core.compiled import "

P = ParamSpec("P")
R = TypeVar("R")

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "boundscheck": False, "fastmath": False}
NOBODY = 65534
"""The owner that Linux shows in a user namespace for those outside of it, such as root."""


def compiled(signature: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function for the given types of arguments, or take what an earlier process made.

    It runs without the interpreter's lock. Arguments of other types raise TypeError. An index beyond the end of an
    array is not checked, and a negative one counts from the end, as in numpy. With `NUMBA_DISABLE_JIT=1` in the
    environment it stays plain Python, for a debugger.

    Args:
        signature: As numba writes it, such as "float32[::1](float32[:, ::1], int64)".
    """

    def making(function: Callable[P, R]) -> Callable[P, R]:
        made = _compiled(function, signature)
        if getattr(made, "stats", None) and not made.stats.cache_hits:
            _say_so_once()
        return cast("Callable[P, R]", made)

    return making


@cache
def _say_so_once() -> None:
    compile_log.info("compiling for this processor, once: up to a minute")


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A part of compiled functions, for any types of arguments."""
    return cast("Callable[P, R]", numba.njit(inline="always", **OPTIONS)(function))


def _compiled(function: Callable[..., Any], signature: str) -> Any:
    if (folder := cache_folder()) is not None:
        try:
            with _kept_in(folder):
                return numba.njit(signature, cache=True, **OPTIONS)(function)
        except (OSError, RuntimeError) as err:  # a full disk; RuntimeError: numba cannot write there
            compile_log.debug("%s cannot be kept in %s: %s", function.__qualname__, folder, err)
        except Exception as err:  # a file that a crash of the machine cut short: the next run keeps all anew
            compile_log.debug("%s: expected what numba keeps, found %r: removed", folder, err)
            for path in folder.iterdir():
                shutil.rmtree(path, ignore_errors=True)
    return numba.njit(signature, **OPTIONS)(function)


def kernel_sources() -> list[tuple[Path, str]]:
    """The files with compiled functions, and their texts, sorted by path."""
    texts = ((path, path.read_text(encoding="utf-8")) for path in sorted((_ROOT / "lidcam" / "pipeline").rglob("*.py")))
    return [(path, text) for path, text in texts if f"\n{_IMPORT}" in text]


@contextmanager
def _kept_in(folder: Path) -> Iterator[None]:
    """Within the block, numba keeps functions there and nowhere else; what a user compiles has another place."""
    before = numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES
    numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES = str(folder), "UserProvidedCacheLocator"
    try:
        yield
    finally:
        numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES = before


@cache
def cache_folder() -> Path | None:
    """Where compiled functions are kept; nothing if another user could change what is there."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    version = sha256(numba.__version__.encode())
    own = [(path, path.read_text(encoding="utf-8")) for path in sorted(Path(__file__).parent.glob("*.py"))]
    for path, text in (*own, *kernel_sources()):
        version.update(f"{path.name}\0{text}\0".encode())
    try:
        caches = Path(named or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache", "lidcam")).expanduser()
        folder = caches.absolute() / f"kernels-{version.hexdigest()[:16]}"
        problem = _made(folder)
    except (OSError, RuntimeError) as err:  # RuntimeError: this user has no home
        problem = str(err)
    if not problem:
        return folder
    compile_log.warning(
        "%s; functions are compiled for this run alone: let NUMBA_CACHE_DIR name a folder of your own", problem
    )
    return None


def _made(folder: Path) -> str:
    """Make a folder if there is none; how another user could change what is in it, or nothing."""
    for path in reversed(folder.parents):
        if not os.path.lexists(path):
            path.mkdir(mode=0o700, exist_ok=True)
        if problem := _changed_by_others(path):
            return problem
    for path in folder.resolve().parents:
        if problem := _changed_by_others(path):
            return problem
    folder.mkdir(mode=0o700, exist_ok=True)
    for path in (folder, *folder.rglob("*")):
        found = path.lstat()
        if found.st_uid != os.geteuid() or stat.S_ISLNK(found.st_mode):
            return f"{path}: expected a file or folder of this user"
    return f"{folder}: expected a folder that is this user's alone" if folder.lstat().st_mode & 0o077 else ""


def _changed_by_others(path: Path) -> str:
    """How another user could replace what lies in a folder, or nothing. A sticky bit, as of `/tmp`, prevents it."""
    found = path.lstat()
    if found.st_uid not in {0, NOBODY, os.geteuid()}:
        return f"{path} belongs to another user"
    if stat.S_ISDIR(found.st_mode) and found.st_mode & 0o022 and not found.st_mode & stat.S_ISVTX:
        return f"{path}: others may write there"
    return ""
