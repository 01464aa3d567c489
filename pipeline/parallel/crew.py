"""The worker processes of a run."""

import select
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Self

from pipeline.parallel.messages import Beginning
from pipeline.parallel.process import WorkerProcess
from pipeline.parallel.sharing import Sharing

__all__ = ["Crew"]


class Crew:
    """Processes that are started when they are worth it, and end with the block; a context manager.

    Attributes:
        sharing: Says how many there should be.
    """

    def __init__(self, beginning: Beginning, sharing: Sharing, ready: Sequence[WorkerProcess] = ()) -> None:
        """Tell the processes that there are what to do.

        Args:
            beginning: What each is told first.
            sharing: Says how many there should be.
            ready: Those that were started before; they end with the others.
        """
        self.sharing = sharing
        self._beginning = beginning
        self._processes: dict[int, WorkerProcess] = {}  # by descriptor
        self._poll = select.poll()
        for process in ready:
            self._add(process)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        processes = [*self._processes.values()]
        for process in processes:
            process.let_go()
        for process in processes:
            process.end()

    def __len__(self) -> int:
        return len(self._processes)

    @property
    def is_starting(self) -> bool:
        """Whether a process has no stages yet."""
        return any(not process.begun for process in self._processes.values())

    def start(self, count: int) -> None:
        """Start more processes, unless the last ones are still about to start.

        Raises:
            WorkerError: one cannot be started.
        """
        if self.is_starting:
            return
        for _ in range(count):
            self._add(WorkerProcess.spawned())

    def _add(self, process: WorkerProcess) -> None:
        self._processes[process.fileno()] = process
        self._poll.register(process, select.POLLIN)
        process.begin(self._beginning)

    def with_room(self) -> WorkerProcess | None:
        """The process that needs a frame most; None if all have enough."""
        having = [process for process in self._processes.values() if process.has_room]
        return min(having, key=lambda process: len(process.numbers), default=None)

    def with_news(self, *, wait: bool) -> Iterator[WorkerProcess]:
        """The processes that have something to say; waits until there is one, if that is wanted."""
        for descriptor, _ in self._poll.poll(None if wait else 0):
            yield self._processes[descriptor]

    def part_with(self, process: WorkerProcess) -> None:
        """End a process."""
        descriptor = next(one for one, other in self._processes.items() if other is process)
        del self._processes[descriptor]
        self._poll.unregister(descriptor)
        process.end()
