"""Worker processes that are copies of this one, made while it has no threads.

A copy has all libraries loaded and all stages made, and shares their memory: it takes some milliseconds, where another
process takes a second or two. But of the threads only the one that asks is copied, so that a lock that another one
holds, in whatever library, would never be released. Where there are others, no copy is made.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

__all__ = ["Copy", "may_fork"]

TASKS = Path("/proc/self/task")
"""Threads of this process, those of libraries, too."""

PATIENCE_S = 0.05
"""Threads that are about to end get so long."""

LONGEST_PAUSE_S = 0.02


def may_fork() -> bool:
    """Whether copies of this process can be made: it runs on Linux, and has one thread, those of libraries counted.

    On macOS system libraries have threads of their own.
    """
    if sys.platform != "linux":
        return False
    end = time.monotonic() + PATIENCE_S
    while (count := _threads()) > 1 and time.monotonic() < end:
        time.sleep(PATIENCE_S / 10)
    return count == 1


def _threads() -> int:
    try:
        return sum(1 for _ in TASKS.iterdir())
    except OSError:
        return 2  # unknown


class Copy:
    """A copy of this process, as `subprocess.Popen` has it.

    Attributes:
        pid: Process id.
    """

    def __init__(self, serve: Callable[[], NoReturn]) -> None:
        """Make it.

        Args:
            serve: What it does; never returns.

        Raises:
            OSError: the system does not let it.
        """
        self._code: int | None = None
        self.pid = os.fork()
        if not self.pid:
            serve()

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; the exit code, or the negative number of the signal that ended it.

        Raises:
            subprocess.TimeoutExpired: it has not ended.
        """
        end, pause_s = time.monotonic() + (timeout or 0.0), 0.0005
        while self._code is None:
            try:
                pid, status = os.waitpid(self.pid, 0 if timeout is None else os.WNOHANG)
            except ChildProcessError:  # awaited by somebody else
                self._code = 0
                break
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() >= end:
                raise subprocess.TimeoutExpired("a worker process", timeout or 0.0)
            else:
                time.sleep(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        return self._code

    def kill(self) -> None:
        """End it at once."""
        if self._code is None:
            os.kill(self.pid, signal.SIGKILL)
