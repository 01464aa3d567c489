"""Worker processes, from the side of the process that started them."""

import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from types import TracebackType
from typing import Protocol, Self, cast

from pipeline.core.ending import undone_at_once
from pipeline.core.errors import WorkerError
from pipeline.parallel.cores import THREADS_OF_LIBRARIES
from pipeline.parallel.protocol import Answer, Question, Ready, Setup
from pipeline.parallel.transfer import connected, receive, send

__all__ = ["Crew", "Process", "WorkerProcess"]

CODE = "import sys; sys.path[:] = sys.argv[2:]; from pipeline.parallel.worker import serve; serve(int(sys.argv[1]))"
"""No module of the user's is imported by name, so a script needs no guard, and what it has in its path is found."""

FROM_OUTSIDE = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that terminals and service managers send to all processes. The one that started the others acts on them."""

AHEAD = 2
"""Frames that a process has at most: one in work, and one at hand, so that it need not wait for the next."""

PATIENCE_S = 1.0


class Process(Protocol):
    """The part of `subprocess.Popen` that is used."""

    def wait(self, timeout: float | None = None) -> int:
        """The exit code; raises `subprocess.TimeoutExpired`."""

    def kill(self) -> None:
        """End it at once."""


def new_interpreter(_: socket.socket, theirs: socket.socket) -> Process:
    """Start a worker in an interpreter of its own, which imports libraries for a second.

    Raises:
        WorkerError: there is no interpreter to start.
        OSError: the system does not allow it.
    """
    if not sys.executable:
        raise WorkerError("no Python interpreter found that could start worker processes: set run.workers to 1")
    command = [sys.executable, "-c", CODE, str(theirs.fileno()), *sys.path]
    # Processes fill the cores; threads inside of one would only wait for each other.
    environment = {**dict.fromkeys(THREADS_OF_LIBRARIES, "1"), **os.environ}
    return subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, env=environment)


class WorkerProcess:
    """A process that works on frames.

    Attributes:
        is_ready: Whether it has made its stages.
        numbers: The frames that it has, in order.
    """

    def __init__(self, start: Callable[[socket.socket, socket.socket], Process] = new_interpreter) -> None:
        """Start it.

        Args:
            start: Starts a process that serves the second socket; the first is the other end.

        Raises:
            WorkerError: there is no interpreter to start, or the system does not allow it.
        """
        self.is_ready = False
        self.numbers: list[int] = []
        self._connection, theirs = connected()
        with ExitStack() as started:
            started.callback(self._connection.close)
            with theirs, _signals_blocked():
                try:
                    self._process = start(self._connection, theirs)
                except OSError as err:
                    raise WorkerError(
                        f"a worker process cannot be started: {err.strerror}: set run.workers to 1"
                    ) from err
            started.pop_all()
        self._open = ExitStack()
        self._open.enter_context(undone_at_once(self._process.kill))

    def set_up(self, setup: Setup) -> None:
        """Tell it what to do."""
        with suppress(OSError):  # it has died, which the first question tells
            send(self._connection, setup)

    @property
    def has_room(self) -> bool:
        """Whether it can take another frame."""
        return self.is_ready and len(self.numbers) < AHEAD

    def fileno(self) -> int:
        """The descriptor to wait for; readable when there is something to receive, or the process is gone."""
        return self._connection.fileno()

    def ask(self, question: Question) -> None:
        """Hand it a frame.

        Raises:
            WorkerError: it has died.
        """
        self.numbers.append(question.number)
        try:
            send(self._connection, question)
        except OSError as err:
            raise self._gone() from err

    def receive(self) -> Ready | Answer:
        """What it says next; waits for it.

        Raises:
            WorkerError: it has died.
        """
        try:
            said = cast("Ready | Answer", receive(self._connection))
        except (EOFError, OSError) as err:
            raise self._gone() from err
        if isinstance(said, Answer):
            self.numbers.remove(said.number)
        else:
            self.is_ready = said.failure is None
        return said

    def let_go(self) -> None:
        """Tell it to end; `end` awaits it."""
        if not self.is_ready:
            self._process.kill()  # it imports libraries, and would listen only then
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)  # also for a child of the user's that has a copy

    def end(self) -> None:
        """End it, and wait for its end."""
        self.let_go()
        self._connection.close()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._open.close()

    def _gone(self) -> WorkerError:
        try:
            code = self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            return WorkerError("a worker process no longer answers")
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        return WorkerError(
            f"a worker process was ended {how}, perhaps for lack of memory; end other programs, or set run.workers to "
            "a smaller number"
        )


class Crew:
    """The worker processes of a run, which end with the block; a context manager."""

    def __init__(self, setup: Setup, started: Sequence[WorkerProcess] = ()) -> None:
        """Each process is given the setup first, those that have been started before, too."""
        self._setup = setup
        self._processes: dict[int, WorkerProcess] = {}  # by descriptor
        self._poll = select.poll()
        for process in started:
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
        return any(not process.is_ready for process in self._processes.values())

    def start(self, count: int) -> None:
        """Start more processes, unless the last ones are still about to start.

        Raises:
            WorkerError: one cannot be started.
        """
        if self.is_starting:
            return
        for _ in range(count):
            self._add(WorkerProcess())

    def _add(self, process: WorkerProcess) -> None:
        self._processes[process.fileno()] = process
        self._poll.register(process, select.POLLIN)
        process.set_up(self._setup)

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
        descriptor = process.fileno()
        del self._processes[descriptor]
        self._poll.unregister(descriptor)
        process.end()


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """What is started in the block never gets these signals, and this thread gets them behind it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_OUTSIDE)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
