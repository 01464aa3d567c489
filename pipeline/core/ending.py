"""What this process undoes when it is ended at once: its temporary files, its children, the state of a terminal.

A program that is told to end does so within milliseconds and from wherever it is: while a library is loading, a thread
waits or the interpreter shuts down, an exception would be lost or turned into another. Nothing unwinds then, so what
has to go is listed here while it exists. (git does so with its temporary files and lock files, in `tempfile.c`.)

Only the programs end in this way; elsewhere a signal is what Python makes of it, and the usual clean-up does the same.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

__all__ = ["end_when_calm", "undisturbed", "undo_all", "undone_at_once", "wait_for_calm"]

MAX_WAIT_S = 10.0
"""An ending waits at most so long for `undisturbed` blocks."""

_undoings: dict[object, Callable[[], object]] = {}
_blocks: list[object] = []
_postponed: list[Callable[[], object]] = []


@contextmanager
def undone_at_once(undo: Callable[[], object]) -> Iterator[None]:
    """Have `undo` called if the process is ended at once within the block.

    It may be called at any point of the block and on any thread, may do nothing that waits, and its errors are ignored.
    """
    key = object()
    _undoings[key] = undo
    try:
        yield
    finally:
        _undoings.pop(key, None)


@contextmanager
def undisturbed() -> Iterator[None]:
    """A block at whose end, not within which, the process may be ended: for steps that belong together. Be brief."""
    key = object()
    _blocks.append(key)
    try:
        yield
    finally:
        _blocks.remove(key)
        if _postponed and not _blocks:
            _postponed.pop()()


def undo_all() -> None:
    """Undo what there is, the youngest first."""
    while _undoings:
        with suppress(Exception):
            _undoings.popitem()[1]()


def end_when_calm(end: Callable[[], object]) -> None:
    """Call `end` now, or at the end of the `undisturbed` block that is open; returns in the latter case."""
    if _blocks:
        _postponed.append(end)
    else:
        end()


def wait_for_calm() -> None:
    """Wait for the `undisturbed` blocks of other threads, but not for ever."""
    until_s = time.monotonic() + MAX_WAIT_S
    while _blocks and time.monotonic() < until_s:
        time.sleep(0.01)
