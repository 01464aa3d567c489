"""Processes that are made before a run begins, while this one has no threads."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from pipeline.graph import Graph, Node
from pipeline.parallel.forked import may_fork
from pipeline.parallel.process import WorkerProcess

__all__ = ["ready_processes"]

FRAMES_EACH = 5
"""Frames that a process needs to be worth its kernels, which each loads for itself in a quarter of a second."""


@contextmanager
def ready_processes(
    graph: Graph[Any], sink: Node[Any], *, workers: int, expected: int
) -> Iterator[list[WorkerProcess]]:
    """As many copies of this process as a run is worth, at most one less than workers; none where it has threads.

    They end with the block.

    Args:
        graph: The stages; more that are `ordered` may be added later.
        sink: The one whose output is wanted, or what it is made from.
        workers: Number of processes at most, with the one that reads.
        expected: About how many frames there will be.
    """
    count = min(workers, expected // FRAMES_EACH) - 1
    processes: list[WorkerProcess] = []
    with ExitStack() as stack:
        if count > 0 and may_fork():
            for _ in range(count):
                processes.append(WorkerProcess.forked(graph, sink, processes))
                stack.callback(processes[-1].end)
        yield processes
