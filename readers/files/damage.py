"""Damage: what libraries raise on damaged files, turned into our errors, and the record of what was lost.

A damaged file makes the libraries raise nearly anything (lz4 a RuntimeError, bz2 an OSError without a number, rosbags
AssertionErrors), so the list is long; anything else (AttributeError, NameError...) is a bug and keeps its traceback.
What reads or parses a part of a file raises one of them, whose text says what was expected, where the file is damaged.
"""

import errno
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self

import yaml
import zstandard
from mcap.exceptions import McapError
from rosbags.rosbag1 import ReaderError

from lidcam.pipeline.core.errors import LidcamError, RecordingError, is_short_memory, short_memory_told
from lidcam.pipeline.core.text import one_line
from lidcam.readers.location import Location
from lidcam.readers.recording import DEFAULT_READ_OPTIONS, Loss, ReadOptions

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
    MemoryError,  # never damage: see `_is_damage`; `library_errors` reports it
    TypeError,
    ValueError,
)


class DamageError(RecordingError):
    """A file is so damaged that it cannot be read, or not all of it."""


class DamageGuard:
    """A context manager that suppresses errors caused by damage in a file; all other errors pass.

    Attributes:
        error: The error that was suppressed; None if there was none.
    """

    def __init__(self, *, is_active: bool) -> None:
        self._is_active = is_active
        self.error: Exception | None = None

    @property
    def reason(self) -> str:
        """`error` in one line; empty if there was none."""
        return "" if self.error is None else _describe(self.error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        if not self._is_active or not isinstance(exc, LIBRARY_ERRORS) or not _is_damage(exc):
            return False
        self.error = exc
        return True


class Losses:
    """Parts of one file that could not be read; each loss is listed once, however often the file is read."""

    def __init__(self, path: Location, options: ReadOptions = DEFAULT_READ_OPTIONS) -> None:
        self.path = path
        self._is_recovering = options.recovery != "none"
        self._max_listed = options.limits.max_losses_listed
        self._listed: dict[tuple[int, str], Loss] = {}
        self._others: set[int] = set()
        self._rest: Loss | None = None

    def guard(self) -> DamageGuard:
        """A guard that suppresses damage unless damage is an error."""
        return DamageGuard(is_active=self._is_recovering)

    def reason(self, error: Exception) -> str:
        """One of `LIBRARY_ERRORS` in one line, if a guard would suppress it: a guard for each message is slow.

        Raises:
            Exception: `error`, if a guard would let it pass.
        """
        if not self._is_recovering or not _is_damage(error):
            raise error
        return _describe(error)

    def note(self, position: int, reason: str, *, size: int | None = None, messages: int | None = None) -> None:
        """Add a loss; arguments as of `Loss`.

        Raises:
            ValueError: damage is an error.
        """
        if not self._is_recovering:
            raise ValueError(f"at byte {position}: {reason}" + (f" ({messages} messages)" if messages else ""))
        key = (position, reason)
        if key in self._listed:
            return
        if len(self._listed) < self._max_listed:
            self._listed[key] = Loss(self.path, position, reason, size, messages)
        elif hash(key) not in self._others:
            self._others.add(hash(key))
            first = self._rest or Loss(self.path, position, "", 0, 0)
            more = f"{len(self._others)} further places, see limit_scale"
            self._rest = Loss(self.path, first.position, more, _sum(first.size, size), _sum(first.messages, messages))

    def listed(self) -> tuple[Loss, ...]:
        """The losses by position, and last the sum of those that are not listed."""
        rest = () if self._rest is None else (self._rest,)
        return (*(self._listed[key] for key in sorted(self._listed)), *rest)


@contextmanager
def library_errors(
    path: Location, *, progress: Callable[[], str] | None = None, is_recovering: bool = False
) -> Iterator[None]:
    """Turn what a library raises while it reads `path` into a `RecordingError`; `progress` says how far it was read.

    Raises:
        RecordingError: instead of any of `LIBRARY_ERRORS`; a `DamageError` if the content is at fault.
        ShortMemoryError: memory could not be had, which says nothing of the file.
    """
    try:
        with short_memory_told(f"read {path}"):
            yield
    except LidcamError:
        raise
    except LIBRARY_ERRORS as err:
        where = f"{path}: {progress()}: " if progress else f"{path}: "
        if isinstance(err, OSError) and _is_of_system(err):
            remedy = "; allow more with `ulimit -n`" if err.errno == errno.EMFILE else ""
            raise RecordingError(f"{where}cannot be read: {err.strerror}{remedy}") from err
        remedy = (
            "nothing in it can be recovered, record or copy it again"
            if is_recovering
            else "without `--on-bad-message fail` what can still be read is read"
        )
        raise DamageError(
            f"{where}the file is damaged or was not closed ({type(err).__name__}: {_describe(err)}); {remedy}"
        ) from err


def _sum(one: int | None, other: int | None) -> int | None:
    return None if one is None or other is None else one + other


def _is_damage(err: Exception) -> bool:
    return not isinstance(err, LidcamError) and not _is_of_system(err) and not is_short_memory(err)


def _is_of_system(err: Exception) -> bool:
    """Whether the operating system raised it; an impossible file position (EINVAL) is the file's own fault."""
    return isinstance(err, OSError) and err.errno not in {None, errno.EINVAL, errno.EOVERFLOW}


def _describe(err: Exception) -> str:
    return one_line(err) or f"unexpected end or value ({type(err).__name__})"
