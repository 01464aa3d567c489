"""A worker process, from the side of the process that started it."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Protocol, Self, cast

from pipeline.core.ending import undone_at_once
from pipeline.core.errors import WorkerError
from pipeline.graph import Graph, Node
from pipeline.parallel.cores import THREADS_OF_LIBRARIES
from pipeline.parallel.forked import Copy
from pipeline.parallel.messages import Answer, Beginning, Begun, Question
from pipeline.parallel.transfer import connected, receive, send
from pipeline.parallel.worker import serve_copy

__all__ = ["WorkerProcess"]

CODE = "import sys; sys.path[:] = sys.argv[2:]; from pipeline.parallel.worker import serve; serve(int(sys.argv[1]))"
"""No module of the user's is imported by name, so a script needs no guard, and what it has in its path is found."""

FROM_OUTSIDE = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that terminals and service managers send to all processes. The one that started the others acts on them."""

AHEAD = 2
"""Frames that a process has at most: one in work, and one at hand, so that it need not wait for the next."""

PATIENCE_S = 1.0


class _Process(Protocol):
    """What is needed of `subprocess.Popen`."""

    pid: int

    def wait(self, timeout: float | None = None) -> int: ...

    def kill(self) -> None: ...


class WorkerProcess:
    """A process that works on frames.

    Attributes:
        begun: Whether it has made its stages.
        numbers: The frames that it has, in order.
    """

    def __init__(self, connection: socket.socket, process: _Process) -> None:
        """Take charge of one that was started: see `spawned` and `forked`."""
        self.begun = False
        self.numbers: list[int] = []
        self._connection, self._process = connection, process
        self._open = ExitStack()
        self._open.enter_context(undone_at_once(self._process.kill))

    @classmethod
    def spawned(cls) -> Self:
        """A new process; it needs a second or two to import libraries.

        Raises:
            WorkerError: there is no interpreter to start, or the system does not let it.
        """
        if not sys.executable:
            raise WorkerError("no Python interpreter found that could start worker processes: set run.workers to 1")
        connection, theirs = connected()
        with ExitStack() as started:
            started.callback(connection.close)
            with theirs, _signals_blocked():
                command = [sys.executable, "-c", CODE, str(theirs.fileno()), *sys.path]
                # Processes fill the cores; threads inside of one would only wait for each other.
                environment = {**dict.fromkeys(THREADS_OF_LIBRARIES, "1"), **os.environ}
                try:
                    process = subprocess.Popen(
                        command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, env=environment
                    )
                except OSError as err:
                    raise _not_started(err) from err
            started.pop_all()
        return cls(connection, process)

    @classmethod
    def forked(cls, graph: Graph[Any], sink: Node[Any], others: Sequence["WorkerProcess"]) -> Self:
        """A copy of this process, which must have a single thread, with the stages that it has.

        Args:
            graph: The stages.
            sink: The one whose output is wanted.
            others: The processes of this run that there are; the copy lets go of their sockets.

        Raises:
            WorkerError: the system does not let it.
        """
        connection, theirs = connected()
        kept_open = [connection.fileno(), *(other.fileno() for other in others)]
        with ExitStack() as started:
            started.callback(connection.close)
            with theirs, _signals_blocked():
                try:
                    process = Copy(lambda: serve_copy(theirs.detach(), kept_open, (graph, sink)))
                except OSError as err:
                    raise _not_started(err) from err
            started.pop_all()
        return cls(connection, process)

    def begin(self, beginning: Beginning) -> None:
        """Tell it what to do."""
        with suppress(OSError):  # it has died, which the first question tells
            send(self._connection, beginning)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def has_room(self) -> bool:
        """Whether it can take another frame."""
        return self.begun and len(self.numbers) < AHEAD

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

    def receive(self) -> Begun | Answer:
        """What it says next; waits for it.

        Raises:
            WorkerError: it has died.
        """
        try:
            said = cast("Begun | Answer", receive(self._connection))
        except (EOFError, OSError) as err:
            raise self._gone() from err
        if isinstance(said, Answer):
            self.numbers.remove(said.number)
        else:
            self.begun = said.failure is None
        return said

    def let_go(self) -> None:
        """Tell it to end; `end` awaits it."""
        if not self.begun:
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


def _not_started(err: OSError) -> WorkerError:
    return WorkerError(f"a worker process cannot be started: {err.strerror}: set run.workers to 1")


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """What is started in the block never gets these signals, and this thread gets them behind it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_OUTSIDE)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
