"""Worker processes that start as copies of this one (`os.fork`): libraries are loaded and stages made.

A copy starts in milliseconds and shares that memory; an interpreter of its own takes a second and 110 MiB. But only the
thread that forks is copied, so a lock that another one holds would stay locked. Where there are other threads, no copy
is made.
"""

import logging
import multiprocessing
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from pipeline.graph import Graph, Node
from pipeline.parallel.process import WorkerProcess
from pipeline.parallel.worker import serve

__all__ = ["copied_workers"]

MIN_FRAMES = 5
"""Frames that a copy must have to be worth its start."""


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
