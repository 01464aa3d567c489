"""How the C library hands out the memory of this process, and what Python's garbage collector looks at."""

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["keep_freed_memory", "objects_stay"]

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's settings (malloc.h)."""

KEPT_BYTES = 256 << 20
"""Free memory at the end of the heap that is not given back to the system."""

LARGE_BYTES = 32 << 20
"""Larger pieces are taken from the system and given back to it one by one."""


def keep_freed_memory() -> None:
    """Keep memory that is freed for what comes next.

    glibc gives back what the arrays of a frame took as soon as they are freed, and the next frame pays for each page
    anew: 1,800 pages to combine 115,000 points. For programs of ours; a library leaves its user's process alone.
    Nothing happens where the C library is not glibc.
    """
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # no such function; Windows has no library of the process
        return
    set_option(MMAP_THRESHOLD, LARGE_BYTES)
    set_option(TRIM_THRESHOLD, KEPT_BYTES)


@contextmanager
def objects_stay() -> Iterator[None]:
    """Within the block, the garbage collector does not look at what is there when it begins.

    Libraries and stages are some hundred thousand objects that stay to the end, and to look for garbage among them took
    5 ms a frame. For programs of ours, as `keep_freed_memory`; where somebody has frozen objects, that stays as it is.
    """
    if gc.get_freeze_count():
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
