"""What Python's garbage collector looks at, and when.

For programs of ours; a library leaves its user's process alone.
"""

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["collect_late", "keep_objects", "objects_stay"]

LATE_OBJECTS = 250_000
"""More than libraries, classes and settings are, before the work of a program begins."""

_USUAL = gc.get_threshold()


def collect_late() -> None:
    """Look for no garbage until more was made than what a program consists of, and for none when it ends.

    That is 150 thousand objects, of which next to nothing is garbage. To look for it 220 times while they were made
    took 5 % of a run of one frame, and to look through all of them again at the end 12 %, though the process was about
    to go with them.
    """
    gc.set_threshold(LATE_OBJECTS, *_USUAL[1:])
    atexit.register(gc.freeze)


def keep_objects() -> None:
    """From now on the garbage collector is as usual, and does not look at what is there."""
    gc.set_threshold(*_USUAL)
    gc.freeze()


@contextmanager
def objects_stay() -> Iterator[None]:
    """As `keep_objects`, within the block.

    Libraries and stages stay to the end, and to look for garbage among them took 5 ms a frame. Where somebody has
    frozen objects, that stays as it is.
    """
    if gc.get_freeze_count():
        gc.set_threshold(*_USUAL)
        yield
        return
    keep_objects()
    try:
        yield
    finally:
        gc.unfreeze()
