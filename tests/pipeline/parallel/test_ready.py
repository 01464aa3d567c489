"""Processes that are copies of the one that reads."""

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from shared_graphs import Frame, Seen, frames, make_graph

from pipeline.core.errors import MessageError, WorkerError
from pipeline.graph import Graph, Node
from pipeline.parallel import forked
from pipeline.parallel.ready import ready_processes
from pipeline.parallel.run import Limits, run_parallel

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


@pytest.fixture(autouse=True)
def _whatever_threads_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runner may have some of a library that is safe."""
    monkeypatch.setattr("pipeline.parallel.ready.may_fork", lambda: True)


@pytest.fixture(autouse=True)
def _nothing_is_left() -> Iterator[None]:
    before = open_descriptors(), children()
    yield
    assert (open_descriptors(), children()) == before


def children() -> set[str]:
    """Processes of this one; those that others have started, such as servers of test fixtures, stay."""
    return {child for task in Path("/proc/self/task").iterdir() for child in (task / "children").read_text().split()}


def open_descriptors() -> int:
    return len([*Path("/proc/self/fd").iterdir()])


def run(
    count: int,
    make: Callable[[], tuple[Graph[Frame], Node[Seen]]] = make_graph,
    *,
    workers: int = 2,
    alone: bool = False,
) -> Iterator[Seen]:
    """The frames of several processes, or of another one alone."""
    graph, sink = make()
    limits = Limits[Frame](workers, 2 if alone else 2 * workers + 1)
    with ready_processes(graph, sink, workers=workers, expected=1000) as ready:
        assert len(ready) == workers - 1
        yield from run_parallel(graph, sink, frames(count), limits, make_graph=make, expected=count, ready=ready)


@pytest.mark.parametrize(("workers", "count"), [(1, 5), (2, 0), (2, 1), (4, 40)])
def test_the_values_of_one_process(workers: int, count: int) -> None:
    graph, sink = make_graph()
    expected = list(graph.run(sink, frames(count)))
    found = list(run(count, workers=workers))
    assert [(one.index, one.total) for one in found] == [(one.index, one.total) for one in expected]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
    if count > 10:
        assert len({one.pid for one in found}) == workers


def test_errors_and_what_cannot_be_sent() -> None:
    found = run(9, partial(make_graph, "message_error", 7))
    assert [next(found).index for _ in range(7)] == list(range(7))
    with pytest.raises(MessageError, match="/points: bad"):
        next(found)
    with pytest.raises(Exception, match="pickle"):
        list(run(9, partial(make_graph, "unsendable_output"), alone=True))


def test_one_that_is_killed_and_one_that_hangs() -> None:
    with pytest.raises(WorkerError, match="ended by SIGKILL"):
        list(run(9, partial(make_graph, "die", 3), alone=True))
    found = run(9, partial(make_graph, "hang", 3), alone=True)
    next(found)
    started = time.monotonic()
    found.close()  # type: ignore[attr-defined]  # a generator
    assert time.monotonic() - started < 30


def test_the_log_comes_from_the_one_that_reads(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "pipeline.test")
    list(run(12, partial(make_graph, "log")))
    told = [record.getMessage() for record in caplog.records if record.name == "pipeline.test"]
    assert sorted(told) == sorted(f"frame {i}: told" for i in range(12))


@pytest.mark.parametrize(("workers", "expected", "count"), [(1, 1000, 0), (4, 1000, 3), (4, 14, 1), (4, 0, 0)])
def test_how_many(workers: int, expected: int, count: int) -> None:
    graph, sink = make_graph()
    with ready_processes(graph, sink, workers=workers, expected=expected) as ready:
        assert len(ready) == count


def test_none_where_there_are_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.parallel.ready.may_fork", forked.may_fork)
    graph, sink = make_graph()
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    try:
        with ready_processes(graph, sink, workers=4, expected=1000) as ready:
            assert not ready
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize(("platform", "tasks", "may"), [("linux", 1, True), ("linux", 2, False), ("darwin", 1, False)])
def test_whether_copies_may_be_made(
    platform: str, tasks: int, may: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for task in range(tasks):
        (tmp_path / str(task)).touch()
    monkeypatch.setattr(forked, "TASKS", tmp_path)
    monkeypatch.setattr(sys, "platform", platform)
    assert forked.may_fork() == may
    monkeypatch.setattr(forked, "TASKS", tmp_path / "unknown")
    assert not forked.may_fork()


def test_none_when_the_system_does_not_let_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> int:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", refuse)
    with pytest.raises(WorkerError, match=r"cannot be started: Resource temporarily.*run\.workers to 1"):
        list(run(3))


SCRIPT = """
import os, sys, time
sys.path[:] = sys.argv[1:]
from pipeline.parallel.ready import ready_processes
from shared_graphs import make_graph
graph, sink = make_graph()
with ready_processes(graph, sink, workers=4, expected=1000) as ready:
    print(*(process.pid for process in ready), flush=True)
    time.sleep(60)
"""


def test_no_copy_outlives_the_one_that_made_it() -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *sys.path], stdout=subprocess.PIPE, env=environment, text=True
    ) as process:
        assert process.stdout is not None
        copies = [int(pid) for pid in process.stdout.readline().split()]
        assert len(copies) == 3
        process.send_signal(signal.SIGKILL)
    end = time.monotonic() + 20
    while any(is_alive(pid) for pid in copies):
        assert time.monotonic() < end
        time.sleep(0.01)


def is_alive(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    except OSError:
        return False
