"""Jobs on this machine: one process each, as many at once as fit."""

import os
import subprocess
import time
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from tempfile import TemporaryFile
from threading import Lock
from typing import Protocol, TypeVar

from pipeline.parallel.cores import usable_cores

__all__ = ["LocalEngine", "Outcome", "Task", "jobs_that_fit"]

JOB_MIB = 1500
"""Memory that a job may take; docs/reliability.md."""

T_co = TypeVar("T_co", covariant=True)
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a command ended.

    Attributes:
        exit_code: Negative: ended by that signal.
        message: The last line that it wrote to standard error.
        processor_s: Its processor time, with that of its children, seconds.
        wall_s: How long it took, seconds.
        peak_mib: Memory of the largest of its processes.
    """

    exit_code: int
    message: str
    processor_s: float
    wall_s: float
    peak_mib: float


class Task(Protocol[T_co]):
    """A job, to be called on a thread."""

    def __call__(self, engine: "LocalEngine", /) -> T_co:
        """Do it, by `engine.run`."""


class LocalEngine:
    """Runs tasks on threads, their commands as processes.

    Args:
        jobs: How many at once.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._children: set[subprocess.Popen[bytes]] = set()
        self._lock, self._is_ending = Lock(), False

    def outcomes(self, tasks: Sequence[Task[T]]) -> Generator[T, None, None]:
        """Do the tasks in their order; what each gives, as it ends. Closing ends those that are at work."""
        pool = ThreadPoolExecutor(self._jobs, thread_name_prefix="lidcam-batch")
        try:
            for future in as_completed([pool.submit(task, self) for task in tasks]):
                yield future.result()
        finally:
            with self._lock:
                self._is_ending = True
                for child in self._children:
                    child.terminate()
            pool.shutdown(cancel_futures=True)

    def run(self, command: Sequence[str], *, keep_open: int) -> Outcome:
        """Run a command to its end.

        Args:
            command: The program and its arguments.
            keep_open: A descriptor that it holds as long as it lives: a lock that outlives this process.
        """
        started = time.monotonic()
        with TemporaryFile() as errors:
            with self._lock:
                if self._is_ending:
                    return Outcome(-15, "the batch ended before it began", 0.0, 0.0, 0.0)
                child = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors, pass_fds=(keep_open,)
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
            usage.ru_utime + usage.ru_stime,
            time.monotonic() - started,
            usage.ru_maxrss / 1024,
        )


def jobs_that_fit(count: int) -> int:
    """How many of `count` jobs cores and memory have room for at once."""
    memory_mib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES") // 2**20
    return max(min(count, usable_cores(), memory_mib // JOB_MIB), 1)
