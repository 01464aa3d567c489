"""Jobs on this machine: one process each, as many at once as fit."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from threading import Lock

from lidcam.batch.engine import ENDED, JOB_MIB, Engine, Outcome
from lidcam.pipeline.parallel.cores import usable_cores

PROCESS = ("-m", "lidcam", "process")
"""What Python runs."""


class LocalEngine(Engine):
    """Runs each job as a process of its own.

    Args:
        jobs: How many at once.
        program: What Python runs with the arguments of a job.
        is_bound: Whether processes end if the thread ends that started them (Linux). Else what is nearly done when a
            batch is killed is not lost.
    """

    def __init__(self, jobs: int, program: Sequence[str] = PROCESS, *, is_bound: bool = False) -> None:
        super().__init__(jobs)
        self._program = program
        self._before = _ended_with_parent() if is_bound and sys.platform == "linux" else None
        self._children: set[subprocess.Popen[bytes]] = set()
        self._lock, self._is_ending = Lock(), False

    def run(self, arguments: Sequence[str], *, keep_open: int | None) -> Outcome:
        """Run it as a process."""
        started = time.monotonic()
        with TemporaryDirectory(prefix="lidcam-batch-") as folder, TemporaryFile() as errors:
            figures = Path(folder) / "figures.json"
            with self._lock:
                if self._is_ending:
                    return ENDED
                child = subprocess.Popen(
                    [sys.executable, *self._program, *arguments, "--json-file", str(figures)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=errors,
                    pass_fds=() if keep_open is None else (keep_open,),
                    preexec_fn=self._before,
                )
                self._children.add(child)
            _, status, usage = os.wait4(child.pid, 0)
            with self._lock:
                child.returncode = os.waitstatus_to_exitcode(status)  # it is gone: nothing may wait for its number
                self._children.discard(child)
            errors.seek(max(errors.seek(0, os.SEEK_END) - 8192, 0))
            lines = errors.read().decode(errors="replace").splitlines()
            return Outcome(
                child.returncode,
                next((line for line in reversed(lines) if line.strip()), ""),
                figures.read_bytes() if figures.is_file() else b"",
                usage.ru_utime + usage.ru_stime,
                time.monotonic() - started,
                usage.ru_maxrss / 1024,
            )

    def _end(self) -> None:
        with self._lock:
            self._is_ending = True
            for child in self._children:
                child.terminate()


def _ended_with_parent() -> Callable[[], object]:
    """A function that has this process get SIGTERM when the thread ends that forked it: prctl(2), PR_SET_PDEATHSIG."""
    prctl = ctypes.CDLL(None).prctl  # found before the fork, after which no lock of the loader may be waited for
    return lambda: prctl(1, int(signal.SIGTERM))


def jobs_that_fit(count: int) -> int:
    """How many of `count` jobs cores and memory have room for at once."""
    memory_mib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES") // 2**20
    return max(min(count, usable_cores(), memory_mib // JOB_MIB), 1)
