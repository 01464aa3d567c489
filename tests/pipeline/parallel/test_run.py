import logging
import os
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import Random
from signal import SIGINT, SIGKILL, SIGSTOP
from subprocess import PIPE, Popen
from unittest.mock import Mock

import numpy as np
import pytest
from shared_graphs import Frame, Seen, frames, make_graph, make_nothing, make_random

from lidcam.pipeline.core.errors import MessageError, WorkerError
from lidcam.pipeline.graph import Graph, Node
from lidcam.pipeline.parallel.process import copied_workers
from lidcam.pipeline.parallel.run import Limits, run_parallel
from lidcam.pipeline.parallel.worker import MakeGraph, WorkerTraceback, log_levels

# The test runner has threads.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")

ways = pytest.mark.parametrize("way", ["interpreter", "copy"], indirect=True)


@pytest.fixture(autouse=True)
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How other processes start; they are there from the first frame on."""
    name: str = getattr(request, "param", "interpreter")
    monkeypatch.setattr("lidcam.pipeline.parallel.run.START_S", 0.0)
    monkeypatch.setattr("lidcam.pipeline.parallel.process._may_fork", lambda: name == "copy")
    return name


def children() -> list[str]:
    return Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text(encoding="ascii").split()


@pytest.fixture(autouse=True)
def _no_process_is_left() -> Iterator[None]:
    before = children()
    yield
    assert children() == before


def run(
    source: Iterator[Frame],
    make: Callable[[], tuple[Graph[Frame], Node[Seen]]] = make_graph,
    *,
    workers: int = 2,
    frames: int = 5,
) -> Iterator[Seen]:
    graph, sink = make()
    with copied_workers(graph, sink, workers=min(workers, frames), frames=1000) as started:
        yield from run_parallel(
            graph,
            sink,
            source,
            Limits(workers, frames),
            make_graph=make,
            expected=9,
            needed=lambda frame: replace(frame, data=memoryview(frame.data)),
            started=started,
        )


@ways
@pytest.mark.parametrize(("workers", "count"), [(1, 5), (2, 0), (2, 1), (3, 40)])
def test_the_values_of_one_process(workers: int, count: int) -> None:
    graph, sink = make_graph()
    found = list(run(iter(frames(count)), workers=workers))
    for one, other in zip(found, graph.run(sink, frames(count)), strict=True):
        assert (one.index, one.total) == (other.index, other.total)
        np.testing.assert_array_equal(one.points, other.points)
    processes = {one.pid for one in found}
    assert len(processes) <= workers
    if count > 10:
        assert len(processes) == workers, "each works on some frames, the one that reads, too"
        assert os.getpid() in processes


def test_random_graphs() -> None:
    for seed in range(3):
        chance = Random(seed)
        stages = [(chance.randrange(9), chance.randrange(9), chance.random() < 0.3) for _ in range(7)]
        make = partial(make_random, tuple(stages))
        graph, sink = make()
        expected = list(graph.run(sink, frames(12)))
        again, sink = make()
        limits = Limits[Frame](2, 1 + seed)
        assert list(run_parallel(again, sink, frames(12), limits, make_graph=make, expected=12)) == expected


@pytest.mark.parametrize(
    ("window", "max_weight", "most"), [(1, 9.0, 1), (4, 9.0, 4), (5, 0.0, 1), (5, 3.0, 3), (5, 100.0, 5)]
)
def test_no_more_frames_are_in_work_than_may_be(window: int, max_weight: float, most: int) -> None:
    taken = 0

    def source() -> Iterator[Frame]:
        nonlocal taken
        for frame in frames(12):
            taken += 1
            yield frame

    graph, sink = make_graph()
    limits = Limits[Frame](2, window, lambda _: 1.0, max_weight)
    seen = run_parallel(graph, sink, source(), limits, make_graph=make_graph, expected=12)
    ahead = [taken - one.index for one in seen]
    assert len(ahead) == 12
    assert max(ahead) <= min(most + 1, window)  # one is read before it is weighed


@pytest.mark.parametrize(
    ("deed", "kind", "text"),
    [
        ("message_error", MessageError, "/points: bad"),
        ("unsendable_error", Exception, "1 and 2"),
        ("no_memory", MemoryError, "Unable to allocate"),
    ],
)
def test_frames_before_an_error_come_out(deed: str, kind: type[Exception], text: str) -> None:
    found = run(iter(frames(20)), partial(make_graph, deed, 7))
    assert [next(found).index for _ in range(7)] == list(range(7))
    with pytest.raises(kind, match=text) as caught:
        next(found)
    assert caught.value.__notes__ == ["in stage do, frame 7, stamp 7000 ns"]


def alone(make: MakeGraph) -> Iterator[Seen]:
    """The frames worked on by another process only, which has room for as many as may be in work."""
    return run(iter(frames(9)), make, frames=2)


@ways
def test_an_error_of_another_process_says_where_it_came_from() -> None:
    found = alone(partial(make_graph, "unsendable_error"))
    with pytest.raises(RuntimeError, match="Unsendable: 1 and 2") as caught:
        next(found)
    assert caught.value.__notes__ == ["in stage do, frame 0, stamp 0 ns"]
    assert isinstance(caught.value.__cause__, WorkerTraceback)
    assert "in _unsendable_error" in str(caught.value.__cause__)


@ways
def test_an_output_that_cannot_be_sent() -> None:
    with pytest.raises(Exception, match="pickle") as caught:
        next(alone(partial(make_graph, "unsendable_output")))
    assert isinstance(caught.value.__cause__, WorkerTraceback)


def test_a_failing_source_yields_what_was_read() -> None:
    def source() -> Iterator[Frame]:
        yield from frames(5)
        raise MessageError("torn")

    found = run(source())
    assert [next(found).index for _ in range(5)] == [*range(5)]
    with pytest.raises(MessageError, match="torn"):
        next(found)


@ways
def test_a_process_that_is_killed() -> None:
    found = alone(partial(make_graph, "die", 3))
    assert [next(found).index for _ in range(2)] == [0, 1]  # the third may have died with it
    with pytest.raises(WorkerError, match="a worker process was ended by SIGKILL, perhaps for lack of memory"):
        list(found)


def test_a_process_that_cannot_make_its_stages() -> None:
    found = run_parallel(*make_graph(), frames(20), Limits[Frame](2, 5), make_graph=make_nothing, expected=20)
    with pytest.raises(MessageError, match="the network cannot be loaded here"):
        list(found)


@pytest.mark.parametrize(("path", "fault"), [("", ""), ("/no/python", "cannot be started: No such file.*")])
def test_no_interpreter_to_start(monkeypatch: pytest.MonkeyPatch, path: str, fault: str) -> None:
    monkeypatch.setattr("sys.executable", path)
    with pytest.raises(WorkerError, match=rf"{fault}set run\.workers to 1"):
        next(run(iter(frames(3))))


@ways
def test_a_process_that_hangs_does_not_hold_up_the_end() -> None:
    before = children()
    found = alone(make_graph)
    next(found)
    (process,) = set(children()) - set(before)
    os.kill(int(process), SIGSTOP)  # it neither answers nor ends
    found.close()  # type: ignore[attr-defined]  # a generator


@ways
@pytest.mark.parametrize("level", [logging.DEBUG, logging.INFO])
def test_the_log_of_other_processes(level: int, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(level, "lidcam.pipeline.test")
    list(run(iter(frames(12)), partial(make_graph, "log")))
    told = [record.getMessage() for record in caplog.records if record.name == "lidcam.pipeline.test"]
    expected = [f"frame {i}: told" for i in range(12)]
    if level == logging.DEBUG:
        expected = [line for i in range(12) for line in (f"frame {i}", f"frame {i}: told")]
    assert sorted(told) == sorted(expected)


def test_time_is_counted_per_stage_in_all_processes() -> None:
    graph, sink = make_graph()
    list(run_parallel(graph, sink, frames(30), Limits[Frame](2, 5), make_graph=make_graph, expected=30))
    assert graph.seconds["work"] >= 0.002 * sum(i % 3 for i in range(30))


@pytest.mark.parametrize(("workers", "expected", "count"), [(1, 1000, 0), (4, 1000, 3), (4, 14, 1), (4, 0, 0)])
@pytest.mark.parametrize("way", ["copy"], indirect=True)
def test_copies_that_are_worth_their_start(workers: int, expected: int, count: int) -> None:
    with copied_workers(*make_graph(), workers=workers, frames=expected) as started:
        assert len(started) == count


def test_no_copies_where_there_are_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    try:
        with copied_workers(*make_graph(), workers=4, frames=1000) as started:
            assert not started
    finally:
        stop.set()
        thread.join()


def test_a_logger_may_appear_while_their_levels_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a thread of a library: the class of this one is asked for meanwhile."""

    class Early:
        @property  # type: ignore[misc]  # as of a mock
        def __class__(self) -> type:
            return type(logging.getLogger("late").handlers)

    with monkeypatch.context() as patch:
        patch.setitem(logging.Logger.manager.loggerDict, "early", Early())
        assert "" in log_levels()


@pytest.mark.parametrize("way", ["copy"], indirect=True)
def test_no_copy_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = BlockingIOError(11, "Resource temporarily unavailable")
    monkeypatch.setattr(os, "fork", Mock(side_effect=refused))
    with pytest.raises(WorkerError, match=r"cannot be started: Resource temporarily.*run\.workers to 1"):
        next(run(iter(frames(3))))


SCRIPT = """
import signal, sys
sys.path[:] = sys.argv[1:]
from lidcam.signals import end_at_signals
from lidcam.pipeline.parallel.process import copied_workers
from shared_graphs import make_graph
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in what it runs in the background
end_at_signals()
with copied_workers(*make_graph(), workers=4, frames=1000):
    print(*open("/proc/thread-self/children").read().split(), flush=True)
    signal.pause()
"""


@pytest.mark.parametrize(("kill", "number", "code"), [(os.kill, SIGKILL, -9), (os.killpg, SIGINT, 130)])
def test_no_copy_outlives_the_process_that_made_it(kill: Callable[[int, int], None], number: int, code: int) -> None:
    """Killed alone, or told to end with its group, as by Ctrl-C: then one process says so."""
    command, alone = [sys.executable, "-c", SCRIPT, *sys.path], {**os.environ, "OMP_NUM_THREADS": "1"}
    with Popen(command, stdout=PIPE, stderr=PIPE, env=alone, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        assert len(process.stdout.readline().split()) == 3
        kill(process.pid, number)
        told = "lidcam: interrupted\n" if number == SIGINT else ""
        assert process.communicate() == ("", told)  # the copies have them open, too: they end with the last of them
    assert process.returncode == code
