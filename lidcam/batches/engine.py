"""Engines run the jobs of a batch: `local.py` and `ray.py`."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from typing import TypeVar

from lidcam.batches.records import JobRecord
from lidcam.readers.location import Location
from lidcam.run.job import Job

JOB_MIB = 1500
"""Memory reserved for a job; docs/reliability.md."""

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
    """Runs jobs on threads, which only wait for the processes that `run` starts.

    Args:
        jobs: Jobs at once.
    """

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

        Args:
            task: The job.
            keep_open: A descriptor that its process holds while it lives, where it runs on this machine: a lock that
                outlives this process.
        """

    @abstractmethod
    def _end(self) -> None:
        """End all running jobs; later calls of `run` start none."""
