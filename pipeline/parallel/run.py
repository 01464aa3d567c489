"""Frames shared among processes: any number of them gives the values of `Graph.run`, in the same order.

One process reads the frames, hands them to others, works on frames itself while it has nothing else to do, and runs
the ordered stages: all of it on the calling thread, so no lock is needed and no stage competes with another.
"""

import logging
import select
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from lidcam.pipeline.core.errors import WorkerError
from lidcam.pipeline.graph import Graph, Node, Stamped
from lidcam.pipeline.parallel.process import WorkerProcess
from lidcam.pipeline.parallel.worker import Answer, Failure, MakeGraph, Question, Setup, log_levels

START_S = 1.0
"""Processor time until a process works on its first frame, in seconds: it imports libraries. 0 awaits all processes."""

MIN_TIMED = 2
"""Fewest frames that tell the time of a frame; the first also loads and compiles what the others use."""

F = TypeVar("F", bound=Stamped)
R = TypeVar("R")


@dataclass(frozen=True)
class Limits(Generic[F]):
    """Limits of the frames in work."""

    workers: int  # Number of processes, the one that reads included
    frames: int  # Largest number of frames in work
    weigh: Callable[[F], float] = lambda _: 0.0  # Weight of a frame
    weight: float = 0.0  # Largest weight of all frames in work; a heavier one is in work alone


def run_parallel(
    graph: Graph[F],
    sink: Node[R],
    frames: Iterable[F],
    limits: Limits[F],
    *,
    make_graph: MakeGraph,
    expected: int,
    needed: Callable[[F], F] = lambda frame: frame,
    started: Sequence[WorkerProcess] = (),
) -> Generator[R, None, None]:
    """The sink's value for each frame, in order. Frames are read on the calling thread.

    The stages of `Graph.parts(sink).ordered` are called in this process. `make_graph` makes the free stages anew, in
    another process: with the same names, in the same order. `needed` reduces a frame to what they read of it, before it
    is sent to one. To the processes that have been `started` come more when they are worth it for the `expected` number
    of frames.

    An error of a stage is raised when the frames before it are out, as by `Graph.run`; so is one of `frames`, and a
    WorkerError if another process cannot be started, or dies.
    """
    setup = Setup(make_graph, tuple(node.name for node in graph.parts(sink).handed), log_levels())
    yield from _Run(graph, sink, limits, needed, setup, expected, iter(frames)).results(started)


def worthwhile(workers: int, left: int, frame_s: float) -> int:
    """Number of processes, up to `workers`, that are worth their start for the frames that are left, at `frame_s` each.

    Each works on frames for at least as long as its start takes.
    """
    return workers if START_S == 0 else max(min(workers, int(max(left, 0) * frame_s / START_S)), 1)


@dataclass(slots=True)
class _Task(Generic[F]):
    number: int
    frame: F
    weight: float
    is_taken: bool = False
    outcome: Answer | Exception | None = None


class _Run(Generic[F]):
    def __init__(
        self,
        graph: Graph[F],
        sink: Node[Any],
        limits: Limits[F],
        needed: Callable[[F], F],
        setup: Setup,
        expected: int,
        frames: Iterator[F],
    ) -> None:
        self._graph, self._sink, self._parts = graph, sink, graph.parts(sink)
        self._limits, self._needed, self._setup, self._frames = limits, needed, setup, frames
        self._processes: list[WorkerProcess] = []
        self._workers, self._expected = min(limits.workers, limits.frames), expected
        self._tried, self._frame_s = 0, 0.0
        self._tasks: deque[_Task[F]] = deque()
        self._read: _Task[F] | None = None  # too heavy for now
        self._count, self._done, self._is_ended = 0, 0, False
        self._error: Exception | None = None  # behind the last frame

    def results(self, started: Sequence[WorkerProcess]) -> Generator[Any, None, None]:
        """First what keeps the others at work, then what is due, then work of its own."""
        try:
            for process in started:
                self._add_process(process)
            yield from self._results()
            if self._error is not None:
                raise self._error
        finally:
            for process in self._processes:
                process.end()
            # The traceback of an error refers to this object. If this referred to the error, the garbage collector
            # would clear the frames in work with it, and CPython 3.11 crashes when it clears views of memory in use.
            self._tasks.clear()
            self._read = self._error = None

    def _results(self) -> Generator[Any, None, None]:
        self._start_more()
        while self._is_starting:
            self._take_in(wait=True)
        while True:
            self._take_in(wait=False)
            self._hand_out()
            untaken = next((task for task in self._tasks if not task.is_taken), None)
            if untaken is None and self._begin_one():
                continue
            if not self._tasks:
                break
            if self._tasks[0].outcome is not None:
                yield self._finished(self._tasks.popleft())
                self._done += 1
            elif untaken is not None:
                self._start_more()
                self._work_on(untaken)
            else:
                self._take_in(wait=True)

    def _start_more(self) -> None:
        """Start other processes if they are worth it: called when this one has time for a frame.

        Where reading and writing fill this process, more of them do not help.
        """
        if START_S == 0 or self._tried >= MIN_TIMED:
            wanted = worthwhile(self._workers, self._expected - self._done, self._frame_s)
            if not self._is_starting:
                for _ in range(wanted - 1 - len(self._processes)):
                    self._add_process(WorkerProcess())

    @property
    def _is_starting(self) -> bool:
        return any(not process.is_ready for process in self._processes)

    def _add_process(self, process: WorkerProcess) -> None:
        self._processes.append(process)
        process.set_up(self._setup)

    def _begin_one(self) -> bool:
        """Whether there is one more frame that may be in work now."""
        limits, tasks = self._limits, self._tasks
        if len(tasks) >= limits.frames:
            return False
        if self._read is None and not self._is_ended:
            try:
                frame = next(self._frames)
            except StopIteration:
                self._is_ended = True
            except Exception as err:
                self._end(err)
            else:
                self._read = _Task(self._count, frame, limits.weigh(frame))
                self._count += 1
        if self._read is None or (tasks and self._read.weight + sum(task.weight for task in tasks) > limits.weight):
            return False
        tasks.append(self._read)
        self._read = None
        return True

    def _hand_out(self) -> None:
        """Hand frames to processes that have room for them, in order."""
        for task in self._tasks:
            if task.is_taken:
                continue
            free = [process for process in self._processes if process.has_room]
            if not free:
                return
            process = min(free, key=lambda one: len(one.numbers))
            task.is_taken = True
            try:
                process.ask(Question(task.number, self._needed(task.frame)))
            except WorkerError as err:
                self._lose(process, err)

    def _take_in(self, *, wait: bool) -> None:
        """Receive the messages of other processes."""
        poll, by_descriptor = select.poll(), {process.fileno(): process for process in self._processes}
        for descriptor in by_descriptor:
            poll.register(descriptor, select.POLLIN)
        for process in [by_descriptor[descriptor] for descriptor, _ in poll.poll(None if wait else 0)]:
            try:
                said = process.receive()
            except WorkerError as err:
                self._lose(process, err)
                continue
            if isinstance(said, Answer):
                self._tasks[said.number - self._tasks[0].number].outcome = said
                if isinstance(said.outcome, Failure):
                    self._is_ended = True
            elif said.failure is not None:
                self._part_with(process)
                self._end(said.failure.raised())

    def _lose(self, process: WorkerProcess, err: WorkerError) -> None:
        """Give up the frames of a process that has died."""
        self._part_with(process)
        if not process.numbers:
            self._end(err)
        for number in process.numbers:
            self._tasks[number - self._tasks[0].number].outcome = err
            self._is_ended = True

    def _part_with(self, process: WorkerProcess) -> None:
        self._processes.remove(process)
        process.end()

    def _end(self, err: Exception) -> None:
        """Take no more frames; the error comes behind those that are in work."""
        self._is_ended, self._read = True, None
        self._error = self._error or err

    def _work_on(self, task: _Task[F]) -> None:
        task.is_taken, started = True, time.perf_counter()
        try:
            values = self._graph.evaluate(self._parts.free, task.frame)
            task.outcome = Answer(task.number, tuple(values[node] for node in self._parts.handed), {})
        except Exception as err:
            task.outcome, self._is_ended = err, True
        taken_s = time.perf_counter() - started
        self._frame_s = min(self._frame_s, taken_s) if self._tried else taken_s
        self._tried += 1

    def _finished(self, task: _Task[F]) -> Any:
        """The sink's value of a frame whose free stages are done."""
        answer, task.outcome = task.outcome, None
        try:
            if isinstance(answer, Exception):
                raise answer
            assert answer is not None
            for record in answer.records:
                logging.getLogger(record.name).handle(record)
            for name, seconds in answer.seconds.items():
                self._graph.seconds[name] += seconds
            if isinstance(answer.outcome, Failure):
                raise answer.outcome.raised()
            handed = answer.outcome
        finally:
            del answer  # see `results`
        known = zip(self._parts.handed, handed, strict=True)
        return self._graph.evaluate(self._parts.ordered, task.frame, known)[self._sink]
