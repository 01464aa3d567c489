"""What Python's garbage collector looks at, and when.

For programs of ours; a library leaves its user's process alone.
"""

import atexit
import gc

__all__ = ["collect_late", "keep_objects"]

LATE_OBJECTS = 250_000
"""More than libraries, classes and settings are, before the work of a program begins."""

_USUAL = gc.get_threshold()


def collect_late() -> None:
    """Look for no garbage until more was made than what a program consists of, and for none when it ends.

    That is 150 thousand objects, of which next to nothing is garbage: to look for it takes a quarter of a second.
    """
    gc.set_threshold(LATE_OBJECTS, *_USUAL[1:])
    atexit.register(gc.freeze)


def keep_objects() -> None:
    """From now on the garbage collector is as usual, and does not look at what is there.

    Libraries and stages stay to the end, and to look for garbage among them takes 5 ms a frame.
    """
    gc.set_threshold(*_USUAL)
    gc.freeze()
