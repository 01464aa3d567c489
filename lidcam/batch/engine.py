"""What runs the jobs of a batch: given tasks, it yields their outcomes. `local.py` and `ray.py` are the two."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import TypeVar

JOB_MIB = 1500
"""Memory that a job may take; docs/reliability.md."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Outcome:
    """How `lidcam process` ended.

    Attributes:
        exit_code: Negative: ended by that signal.
        message: The last line that it wrote to standard error.
        figures: What `--json-file` says; empty if it did not get that far.
        processor_s: Its processor time, with that of its children, seconds.
        wall_s: How long it took, seconds.
        peak_mib: Memory of the largest of its processes.
    """

    exit_code: int
    message: str
    figures: bytes = b""
    processor_s: float = 0.0
    wall_s: float = 0.0
    peak_mib: float = 0.0


ENDED = Outcome(-15, "the batch ended before it did")


class Engine(ABC):
    """Runs tasks on threads, which have nothing to do but wait for what they give to `run`.

    Args:
        jobs: How many at once.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def outcomes(self, tasks: Sequence[Callable[["Engine"], T]]) -> Generator[T, None, None]:
        """Do the tasks in their order; what each gives, as it ends. Closing ends those that are at work."""
        pool = ThreadPoolExecutor(self._jobs, thread_name_prefix="lidcam-batch")
        try:
            for future in as_completed([pool.submit(task, self) for task in tasks]):
                yield future.result()
        finally:
            self._end()
            pool.shutdown(cancel_futures=True)

    @abstractmethod
    def run(self, arguments: Sequence[str], *, keep_open: int | None) -> Outcome:
        """Run `lidcam process` to its end; for tasks, from their threads.

        Args:
            arguments: Those of its command line, all but `--json-file`.
            keep_open: A descriptor that it holds as long as it lives, where it runs on this machine: a lock that
                outlives this process.
        """

    @abstractmethod
    def _end(self) -> None:
        """End all that runs; what is given to `run` from now on does not begin."""
