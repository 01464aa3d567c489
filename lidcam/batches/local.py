"""Jobs on this machine: one process each, as many at once as fit."""

import ctypes
import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from tempfile import TemporaryFile
from threading import Lock
from typing import BinaryIO, TypeVar

from lidcam.batches.records import JobRecord
from lidcam.pipeline.parallel.cores import THREADS_OF_LIBRARIES
from lidcam.readers.location import Location
from lidcam.run.job import Job

JOB_MIB = 1500
"""Memory reserved for a job; docs/many.md."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Task:
    """A job for a process of its own."""

    record: JobRecord  # The record of the job, to be completed
    job: Job  # The job without outputs
    outputs: tuple[Location, ...]  # Its outputs, local or in a bucket, the result first


def cancelled(task: Task) -> JobRecord:
    """The record of a job that ended with its batch."""
    return replace(task.record, state="failed", exit_code=-15, message="the batch ended before it did")


class Engine(ABC):
    """Runs up to `jobs` jobs at once, on threads, which only wait for the processes that `run` starts."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def outcomes(self, steps: Sequence[Callable[["Engine"], T]]) -> Generator[T, None, None]:
        """Call the functions in their order, and yield each result when it is there. Closing ends the running jobs."""
        pool = ThreadPoolExecutor(self._jobs, thread_name_prefix="lidcam-batch")
        try:
            for future in as_completed([pool.submit(step, self) for step in steps]):
                yield future.result()
        finally:
            self._end()
            pool.shutdown(cancel_futures=True)

    @abstractmethod
    def run(self, task: Task, *, keep_open: int | None) -> JobRecord:
        """Run a job to its end; called from the threads.

        Where its process runs on this machine, it holds the descriptor `keep_open` while it lives: a lock that outlives
        this process.
        """

    @abstractmethod
    def _end(self) -> None:
        """End all running jobs; later calls of `run` start none."""


WORKER = ("-P", "-c", "from lidcam.batches.worker import serve; serve()")
"""Arguments of Python for the process that jobs are copies of, which takes no code from the folder that it runs in."""

TAIL_BYTES = 8192


class LocalEngine(Engine):
    """Runs each job as a process of its own, a copy of one that has imported what jobs need.

    Args:
        jobs: Jobs at once.
        program: Arguments of Python for the process that jobs are copies of; see `lidcam.batches.worker.serve`.
        is_bound: Whether processes end with the thread that started them (Linux). Otherwise a batch that is killed
            does not take its jobs along.
    """

    def __init__(self, jobs: int, program: Sequence[str] = WORKER, *, is_bound: bool = False) -> None:
        super().__init__(jobs)
        self._program = program
        self._before = _ended_with_parent() if is_bound and sys.platform == "linux" else None
        self._servers: list[_Server] = []
        self._idle: list[_Server] = []
        self._lock, self._is_ending = Lock(), False

    def run(self, task: Task, *, keep_open: int | None) -> JobRecord:
        """Run it as a process."""
        started = time.monotonic()
        with TemporaryFile() as given, TemporaryFile() as result, TemporaryFile() as errors:
            pickle.dump(task, given)
            given.seek(0)
            with self._lock:
                if self._is_ending:
                    return cancelled(task)
                if not self._idle:
                    self._idle.append(_Server(self._program, task, errors, self._before))
                    self._servers.append(self._idle[-1])
                server = self._idle.pop()
            files = [given.fileno(), result.fileno(), errors.fileno()]
            code, processor_s, peak_kib = server.run(files if keep_open is None else [*files, keep_open])
            if server.returncode is None:
                self._idle.append(server)
            result.seek(0)
            record = pickle.load(result) if code == 0 else None  # noqa: S301  # of our own process
            return replace(
                record or _crashed(task, code, errors),
                processor_s=round(processor_s, 2),
                wall_s=round(time.monotonic() - started, 2),
                peak_mib=round(peak_kib / 1024, 1),
            )

    def _end(self) -> None:
        with self._lock:
            self._is_ending = True
        for server in self._servers:
            server.terminate()
        for server in self._servers:
            server.end()


class _Server(subprocess.Popen[bytes]):
    """A process that has imported what jobs need, and runs them one after another, each in a copy of itself."""

    def __init__(
        self, program: Sequence[str], task: Task, errors: BinaryIO, before: Callable[[], object] | None
    ) -> None:
        # Workers fill the cores; threads of libraries within each would wait for each other.
        threads = dict.fromkeys(THREADS_OF_LIBRARIES, "1") if task.job.config.run.workers != 1 else {}
        command, env = [sys.executable, *program], {**threads, **os.environ}
        self.link, theirs = socket.socketpair()
        with theirs:
            super().__init__(command, stdin=theirs.fileno(), stderr=errors, env=env, preexec_fn=before)

    def run(self, files: Sequence[int]) -> tuple[int, float, int]:
        """Run a job that gets these descriptors; returns its exit code and usage, or the code that this ended with."""
        try:
            socket.send_fds(self.link, [b"\0"], files)
            with self.link.makefile("rb") as answers:
                status, *usage = pickle.load(answers)  # noqa: S301  # of our own process
        except (EOFError, OSError):
            return self.end(), 0.0, 0
        return os.waitstatus_to_exitcode(status), *usage

    def end(self) -> int:
        """Let it end when it is idle, and return its exit code."""
        self.link.close()
        return self.wait()


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
