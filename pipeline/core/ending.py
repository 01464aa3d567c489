"""Clean-up when a signal ends the process at once: temporary files, children, the state of a terminal.

Nothing unwinds then, so what has to go is listed here while it exists (as git does in `tempfile.c`). Only the programs
end in this way; elsewhere a signal is what Python makes of it, and the usual clean-up does the same.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

ENDING_SIGNALS = {
    getattr(signal, name): reason
    for name, reason in {
        "SIGINT": "interrupted",
        "SIGTERM": "terminated",
        "SIGHUP": "ended: its terminal was closed",
    }.items()
    if hasattr(signal, name)
}
"""Signals that terminals and service managers send to all processes, with the words for their effect."""

_undoings: dict[object, Callable[[], object]] = {}


@contextmanager
def undone_at_once(undo: Callable[[], object]) -> Iterator[None]:
    """Have `undo` called if the process is ended at once within the block.

    It may be called at any point of the block, may do nothing that waits, and its errors are ignored.
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
