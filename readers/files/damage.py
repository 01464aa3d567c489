"""Damage: the errors of the reading libraries in our words, and the account of what was lost.

A damaged file makes the libraries raise nearly anything (lz4 a RuntimeError, bz2 an OSError without number, rosbags
AssertionErrors), so the list is long; what is not in it (AttributeError, NameError...) is a bug, with its traceback.
"""

import errno
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import yaml
import zstandard
from mcap.exceptions import McapError
from rosbags.rosbag1 import ReaderError

from pipeline.core.errors import LidcamError, RecordingError
from pipeline.core.settings.recording import DEFAULT_LIMITS
from readers.location import Location
from readers.recording import Loss

__all__ = ["LIBRARY_ERRORS", "DamageError", "Losses", "damaged", "describe", "is_damage", "opening"]

LIBRARY_ERRORS: tuple[type[Exception], ...] = (
    ReaderError,
    McapError,
    sqlite3.Error,
    zstandard.ZstdError,
    yaml.YAMLError,
    struct.error,
    OSError,  # also bz2
    EOFError,
    RuntimeError,  # lz4
    ArithmeticError,
    AssertionError,
    LookupError,
    MemoryError,  # a length field that was overwritten
    TypeError,
    ValueError,
)


MAX_OTHERS = 1_000_000
"""Parts beyond those that are listed that are still told apart, so that each counts once."""


class DamageError(RecordingError):
    """A file is damaged so that nothing, or not all of it, can be read."""


class Losses:
    """What one file lost, each part noted once, however often the file is read.

    Args:
        path: The file that is named.
        max_listed: Parts that are kept one by one; the others are added up to one.
    """

    def __init__(self, path: Location, max_listed: int = DEFAULT_LIMITS.max_losses_listed) -> None:
        self._path = path
        self._most_listed = max_listed
        self._parts: dict[tuple[int, str], Loss] = {}
        self._others: set[int] = set()
        self._rest: Loss | None = None

    def note(self, position: int, reason: str, *, size: int | None = None, messages: int | None = None) -> None:
        """Note a part, if it was not noted before; arguments as of `Loss`."""
        key = (position, reason)
        if key in self._parts:
            return
        loss = Loss(self._path, position, reason, size, messages)
        if len(self._parts) < self._most_listed:
            self._parts[key] = loss
        elif hash(key) not in self._others and len(self._others) < MAX_OTHERS:
            self._others.add(hash(key))
            self._rest = _sum(self._rest, loss, len(self._others))

    def listed(self) -> tuple[Loss, ...]:
        """All parts by position, and last the sum of those that are not kept."""
        rest = () if self._rest is None else (self._rest,)
        return (*(self._parts[key] for key in sorted(self._parts)), *rest)


def _sum(rest: Loss | None, loss: Loss, count: int) -> Loss:
    at_least = "" if count < MAX_OTHERS else " or more"
    reason = f"{count}{at_least} further places, see limits.max_losses_listed; the first of them: "
    if rest is None:
        return replace(loss, reason=reason + loss.reason)
    first = rest.reason.partition("the first of them: ")[2]
    size = None if rest.size is None or loss.size is None else rest.size + loss.size
    messages = None if rest.messages is None or loss.messages is None else rest.messages + loss.messages
    return Loss(loss.path, rest.position, reason + first, size, messages)


def is_damage(err: Exception) -> bool:
    """Whether a library raised `err` because of what the file holds, rather than because it cannot be reached."""
    return isinstance(err, LIBRARY_ERRORS) and not isinstance(err, LidcamError) and not _is_of_system(err)


def _is_of_system(err: Exception) -> bool:
    """Whether the operating system reports it; a place that no file can have is the file's own fault."""
    return isinstance(err, OSError) and err.errno not in {None, errno.EINVAL, errno.EOVERFLOW}


def describe(err: Exception) -> str:
    """What a library raised, in one line."""
    return " ".join(str(err).split()) or f"unexpected end or value ({type(err).__name__})"


def damaged(path: Location, err: Exception, *, progress: str = "", rescued: bool = False) -> RecordingError:
    """The error to raise for `err`.

    Args:
        path: The file.
        err: What a library raised.
        progress: How far the file was read.
        rescued: Whether it was tried to read what can still be read.
    """
    where = f"{path}: {progress}: " if progress else f"{path}: "
    if isinstance(err, OSError) and _is_of_system(err):
        return RecordingError(f"{where}cannot be read: {err.strerror}")
    remedy = (
        "nothing in it can be saved, record or copy it again"
        if rescued
        else "without `--on-bad-message fail` what can still be read is read"
    )
    return DamageError(
        f"{where}the file is damaged or was not closed ({type(err).__name__}: {describe(err)}); {remedy}"
    )


@contextmanager
def opening(path: Location, *, rescued: bool = False) -> Iterator[None]:
    """Turn what a library raises while it opens `path` into a `RecordingError`.

    Raises:
        RecordingError: instead of any of `LIBRARY_ERRORS`; a `DamageError` where the content is at fault.
    """
    try:
        yield
    except LidcamError:
        raise
    except LIBRARY_ERRORS as err:
        raise damaged(path, err, rescued=rescued) from err
