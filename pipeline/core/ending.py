"""What this process undoes when it is ended at once: its temporary files, its children, the state of a terminal.

A program that is told to end does so within milliseconds and from wherever it is: while a library is loading, a thread
waits or the interpreter shuts down, an exception would be lost or turned into another. Nothing unwinds then, so what
has to go is listed here while it exists. (git does so with its temporary files and lock files, in `tempfile.c`.)

Only the programs end in this way; elsewhere a signal is what Python makes of it, and the usual clean-up does the same.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

__all__ = ["undo_all", "undone_at_once"]

_undoings: dict[object, Callable[[], object]] = {}


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


def undo_all() -> None:
    """Undo what there is, the youngest first."""
    while _undoings:
        with suppress(Exception):
            _undoings.popitem()[1]()
