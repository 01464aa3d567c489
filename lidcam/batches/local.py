"""Jobs on this machine: one process each, as many at once as fit."""

import ctypes
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from tempfile import TemporaryFile
from threading import Lock
from typing import BinaryIO

from lidcam.batches.engine import JOB_MIB, Engine, Task, cancelled
from lidcam.batches.records import JobRecord
from lidcam.pipeline.core.system import free_memory_mib
from lidcam.pipeline.parallel.cores import THREADS_OF_LIBRARIES, usable_cores

WORKER = ("-P", "-m", "lidcam.batches.worker")
"""Arguments of Python for the process of a job, which takes no code from the folder that it runs in."""

TAIL_BYTES = 8192


class LocalEngine(Engine):
    """Runs each job as a process of its own.

    Args:
        jobs: Jobs at once.
        program: Arguments of Python for the process of a job.
        is_bound: Whether processes end with the thread that started them (Linux). Otherwise a batch that is killed
            does not take its jobs along.
    """

    def __init__(self, jobs: int, program: Sequence[str] = WORKER, *, is_bound: bool = False) -> None:
        super().__init__(jobs)
        self._program = program
        self._before = _ended_with_parent() if is_bound and sys.platform == "linux" else None
        self._children: set[subprocess.Popen[bytes]] = set()
        self._lock, self._is_ending = Lock(), False

    def run(self, task: Task, *, keep_open: int | None) -> JobRecord:
        """Run it as a process."""
        started = time.monotonic()
        is_parallel = task.job.config.run.workers != 1
        with TemporaryFile() as given, TemporaryFile() as result, TemporaryFile() as errors:
            pickle.dump(task, given)
            given.seek(0)
            with self._lock:
                if self._is_ending:
                    return cancelled(task)
                child = subprocess.Popen(
                    [sys.executable, *self._program],
                    stdin=given,
                    stdout=result,
                    stderr=errors,
                    # Workers fill the cores; threads of libraries within each would wait for each other.
                    env={**(dict.fromkeys(THREADS_OF_LIBRARIES, "1") if is_parallel else {}), **os.environ},
                    pass_fds=() if keep_open is None else (keep_open,),
                    preexec_fn=self._before,
                )
                self._children.add(child)
            _, status, usage = os.wait4(child.pid, 0)
            with self._lock:
                child.returncode = os.waitstatus_to_exitcode(status)  # it is gone: nothing may wait for its number
                self._children.discard(child)
            result.seek(0)
            record = pickle.load(result) if child.returncode == 0 else None  # noqa: S301  # of our own process
            return replace(
                record or _crashed(task, child.returncode, errors),
                processor_s=round(usage.ru_utime + usage.ru_stime, 2),
                wall_s=round(time.monotonic() - started, 2),
                peak_mib=round(usage.ru_maxrss / 1024, 1),
            )

    def _end(self) -> None:
        with self._lock:
            self._is_ending = True
            for child in self._children:
                child.terminate()


def _crashed(task: Task, code: int, errors: BinaryIO) -> JobRecord:
    """The record of a job whose process gave none."""
    errors.seek(max(errors.seek(0, os.SEEK_END) - TAIL_BYTES, 0))
    lines = errors.read().decode(errors="replace").split("\n")
    message = next((line.strip() for line in reversed(lines) if line.strip()), f"ended with exit code {code}")
    if code < 0 or code > 128:
        message = f"ended by signal {-code if code < 0 else code - 128}"
    return replace(task.record, state="failed", exit_code=code, message=message)


def _ended_with_parent() -> Callable[[], object]:
    """A function that has this process get SIGTERM when the thread ends that forked it: prctl(2), PR_SET_PDEATHSIG."""
    prctl = ctypes.CDLL(None).prctl  # found before the fork, after which no lock of the loader may be waited for
    return lambda: prctl(1, int(signal.SIGTERM))


def jobs_that_fit(count: int) -> int:
    """The number of jobs, of `count`, that cores and memory have room for at once."""
    return max(min(count, usable_cores(), free_memory_mib() // JOB_MIB), 1)
