"""Worker processes, from the side of the process that started them.

A worker starts as a copy of this process (`os.fork`), with libraries loaded and stages made, or in an interpreter of
its own. A copy starts in milliseconds and shares that memory; an interpreter takes a second and 110 MiB. But only the
thread that forks is copied, and a lock that another one holds would stay locked: where there are other threads, no copy
is made.
"""

import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any, cast

from lidcam.pipeline.core.ending import ENDING_SIGNALS, undone_at_once
from lidcam.pipeline.core.errors import WorkerError
from lidcam.pipeline.graph import Graph, Node
from lidcam.pipeline.parallel.cores import THREADS_OF_LIBRARIES
from lidcam.pipeline.parallel.transfer import connected, receive, send
from lidcam.pipeline.parallel.worker import Answer, Question, Ready, Setup, Stages, serve

CODE = (
    "import sys; sys.path[:] = sys.argv[2:]; from lidcam.pipeline.parallel.worker import serve; serve(int(sys.argv[1]))"
)
"""Imports no module of the user's by name, so a script needs no guard, and passes the path of modules on."""

MAX_FRAMES = 2
"""Most frames of a process: one in work, and one at hand, so that it need not wait for the next."""

PATIENCE_S = 1.0
"""Time in which a process may end before it is killed, seconds."""

MIN_FRAMES = 5
"""Fewest frames of a copy that is worth its start."""


class _Copy(ForkProcess):
    """A copy of this process; waited for and killed as a `subprocess.Popen`."""

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, or the negative number of the signal that ended it.

        Raises:
            subprocess.TimeoutExpired: it has not ended.
        """
        self.join(timeout)
        if self.exitcode is None:
            raise subprocess.TimeoutExpired("a worker process", timeout or 0.0)
        return self.exitcode


def _new_interpreter(theirs: socket.socket) -> "subprocess.Popen[bytes]":
    if not sys.executable:
        raise WorkerError("no Python interpreter found that could start worker processes: set run.workers to 1")
    command = [sys.executable, "-c", CODE, str(theirs.fileno()), *sys.path]
    # Processes fill the cores; threads inside of one would only wait for each other.
    environment = {**dict.fromkeys(THREADS_OF_LIBRARIES, "1"), **os.environ}
    return subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, env=environment)


def _new_copy(ours: socket.socket, theirs: socket.socket, stages: Stages) -> _Copy:
    copy = _Copy(target=_serve_in_copy, args=(ours, theirs, stages), daemon=True)
    copy.start()
    return copy


def _serve_in_copy(ours: socket.socket, theirs: socket.socket, stages: Stages) -> None:
    ours.close()  # else this end would never be seen as closed
    root = logging.getLogger()
    for logger in (root, *root.manager.loggerDict.values()):
        if isinstance(logger, logging.Logger):
            logger.handlers.clear()  # the process that reads shows what is logged here
    serve(theirs.detach(), stages)


class WorkerProcess:
    """A process that works on frames.

    Attributes:
        is_ready: Whether it has made its stages.
        numbers: Numbers of the frames that it has, in order.
    """

    def __init__(self, stages: Stages | None = None) -> None:
        """Start a copy of this process with these stages, or a new interpreter; raises WorkerError if it cannot."""
        self.is_ready = False
        self.numbers: list[int] = []
        self._connection, theirs = connected()
        self._process: subprocess.Popen[bytes] | _Copy
        try:
            with theirs, signals_blocked():
                self._process = _new_copy(self._connection, theirs, stages) if stages else _new_interpreter(theirs)
        except (OSError, WorkerError) as err:
            self._connection.close()
            if isinstance(err, WorkerError):
                raise
            raise WorkerError(f"a worker process cannot be started: {err.strerror}: set run.workers to 1") from err
        self._open = ExitStack()
        self._open.enter_context(undone_at_once(self._process.kill))

    def set_up(self, setup: Setup) -> None:
        """Tell it what to do."""
        with suppress(OSError):  # it has died, which the first question tells
            send(self._connection, setup)

    @property
    def has_room(self) -> bool:
        """Whether it can take another frame."""
        return self.is_ready and len(self.numbers) < MAX_FRAMES

    def fileno(self) -> int:
        """Descriptor that is readable when there is something to receive, or the process is gone."""
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
        """Wait for the next message of the process.

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

    def end(self) -> None:
        """End it, and wait for its end."""
        if not self.is_ready:
            self._process.kill()  # it imports libraries, and would listen only then
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)  # also for a child of the user's that has a copy
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


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Block signals from outside: processes that start in the block never get them, this thread gets them after it.

    Raises:
        WorkerError: the system cannot.
    """
    if not hasattr(signal, "pthread_sigmask"):
        raise WorkerError("expected Linux or macOS for worker processes, found Windows: set run.workers=1")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [*ENDING_SIGNALS])
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
        workers: Largest number of processes, this one included.
        frames: Expected number of frames.

    Raises:
        WorkerError: the system does not allow it.
    """
    count = min(workers, frames // MIN_FRAMES) - 1
    copies: list[WorkerProcess] = []
    with ExitStack() as stack:
        if count > 0 and _may_fork():
            for _ in range(count):
                copies.append(WorkerProcess((graph, sink)))
                stack.callback(copies[-1].end)
        yield copies


def _may_fork() -> bool:
    """Whether this process runs on Linux and has one thread, those of libraries counted."""
    return sys.platform == "linux" and len([*Path("/proc/self/task").iterdir()]) == 1
