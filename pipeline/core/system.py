"""One door to what Linux and macOS have and Windows lacks: locks, flags of open(2).

Under Windows lidcam is imported and reads recordings. It does not write there: nobody has tried how its locks, and its
folders that get their names when they are whole, fare among the rules of that system.
"""

import os
from pathlib import Path
from typing import IO

from lidcam.pipeline.core.errors import OutputError

try:
    import fcntl
except ImportError:
    HAS_LOCKS = False
else:
    HAS_LOCKS = True

NO_FOLLOW, NO_WAIT, NOT_INHERITED = (getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC"))
"""Flags of open(2): fail at a link, do not wait for a FIFO, close the file in programs that are started."""


def check_writable_here() -> None:
    """Check that this system is one on which lidcam writes.

    Raises:
        OutputError: it is not.
    """
    if not HAS_LOCKS:
        raise OutputError(
            "expected Linux or macOS to write files, found Windows, where lidcam only reads: run it in WSL "
            "(`wsl --install`) or in a container"
        )


def lock_file(file: IO[bytes], *, is_awaited: bool = False) -> None:
    """Hold the lock of an open file as long as it is open (flock: gone with the process).

    Raises BlockingIOError if another process has it, and is not awaited, OSError if the file system has no locks, and
    OutputError if the system has none.
    """
    check_writable_here()
    fcntl.flock(file, fcntl.LOCK_EX | (0 if is_awaited else fcntl.LOCK_NB))


def read_at(file: IO[bytes], size: int, at: int) -> bytes:
    """At most `size` bytes of an open file from `at` on, or OSError; leaves its position alone."""
    if hasattr(os, "pread"):
        return os.pread(file.fileno(), size, at)
    with Path(file.name).open("rb") as again:
        again.seek(at)
        return again.read(size)


def free_memory_mib() -> int:
    """Free memory in MiB, else all of it (macOS), else of a small machine (Windows)."""
    names = getattr(os, "sysconf_names", {})
    pages = next((name for name in ("SC_AVPHYS_PAGES", "SC_PHYS_PAGES") if name in names), None)
    return 4096 if pages is None else os.sysconf("SC_PAGE_SIZE") * os.sysconf(pages) // 2**20
