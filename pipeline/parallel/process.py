"""Worker processes, from the side of the process that started them.

A worker starts as a copy of this process (`os.fork`), with libraries loaded and stages made, or in an interpreter of
its own. A copy starts in milliseconds and shares that memory; an interpreter takes a second and 110 MiB. But only the
thread that forks is copied, and a lock that another one holds would stay locked: where there are other threads, no copy
is made.
"""

import logging
import multiprocessing
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from lidcam.pipeline.core.ending import undone_at_once
from lidcam.pipeline.core.errors import WorkerError
from lidcam.pipeline.graph import Graph, Node
from lidcam.pipeline.parallel.cores import THREADS_OF_LIBRARIES
from lidcam.pipeline.parallel.transfer import connected, receive, send
from lidcam.pipeline.parallel.worker import Answer, Question, Ready, Setup, serve

CODE = (
    "import sys; sys.path[:] = sys.argv[2:]; from lidcam.pipeline.parallel.worker import serve; serve(int(sys.argv[1]))"
)
"""Imports no module of the user's by name, so a script needs no guard, and passes the path of modules on."""

FROM_OUTSIDE = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that terminals and service managers send to all processes. The one that started the others acts on them."""

AHEAD = 2
"""Frames that a process has at most: one in work, and one at hand, so that it need not wait for the next."""

PATIENCE_S = 1.0
"""Time in which a process may end before it is killed, seconds."""

MIN_FRAMES = 5
"""Frames that a copy must have to be worth its start."""


def new_interpreter(_: socket.socket, theirs: socket.socket) -> subprocess.Popen[bytes]:
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


class _Copy:
    """A copy of this process; waited for and killed as a `subprocess.Popen`."""

    def __init__(self, ours: socket.socket, theirs: socket.socket, graph: Graph[Any], sink: Node[Any]) -> None:
        self._process = multiprocessing.get_context("fork").Process(
            target=_serve_in_copy, args=(ours, theirs, graph, sink), daemon=True
        )
        self._process.start()

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, or the negative number of the signal that ended it.

        Raises:
            subprocess.TimeoutExpired: it has not ended.
        """
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired("a worker process", timeout or 0.0)
        return self._process.exitcode

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()


def _serve_in_copy(ours: socket.socket, theirs: socket.socket, graph: Graph[Any], sink: Node[Any]) -> None:
    ours.close()  # else this end would never be seen as closed
    root = logging.getLogger()
    for logger in (root, *root.manager.loggerDict.values()):
        if isinstance(logger, logging.Logger):
            logger.handlers.clear()  # the process that reads shows what is logged here
    serve(theirs.detach(), (graph, sink))


class WorkerProcess:
    """A process that works on frames.

    Attributes:
        is_ready: Whether it has made its stages.
        numbers: Numbers of the frames that it has, in order.
    """

    def __init__(
        self, start: Callable[[socket.socket, socket.socket], "subprocess.Popen[bytes] | _Copy"] = new_interpreter
    ) -> None:
        """Start a process that serves the second of two connected sockets.

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
        """Its next message; waits for it.

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
        """Have it end; `end` waits for it."""
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
        """The process with the fewest frames; None if none has room."""
        having = [process for process in self._processes.values() if process.has_room]
        return min(having, key=lambda process: len(process.numbers), default=None)

    def with_news(self, *, wait: bool) -> Iterator[WorkerProcess]:
        """The processes with a message to receive; optionally waits until there is one."""
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
    """Block signals from outside: processes that start in the block never get them, this thread gets them after it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_OUTSIDE)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def copied_workers(graph: Graph[Any], sink: Node[Any], *, workers: int, frames: int) -> Iterator[list[WorkerProcess]]:
    """Copies of this process for a run of some frames; an empty list if it has threads. They end with the block.

    Args:
        graph: The stages; more that are `ordered` may be added later.
        sink: Handle of the values that the run yields, or of what they are made from.
        workers: Number of processes at most, with this one.
        frames: About how many frames there will be.

    Raises:
        WorkerError: the system does not allow it.
    """
    count = min(workers, frames // MIN_FRAMES) - 1
    copies: list[WorkerProcess] = []
    with ExitStack() as stack:
        if count > 0 and _may_fork():
            for _ in range(count):
                copies.append(WorkerProcess(lambda ours, theirs: _Copy(ours, theirs, graph, sink)))
                stack.callback(copies[-1].end)
        yield copies


def _may_fork() -> bool:
    """Whether this process runs on Linux and has one thread, those of libraries counted."""
    return sys.platform == "linux" and len([*Path("/proc/self/task").iterdir()]) == 1
