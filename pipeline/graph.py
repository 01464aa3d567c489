"""A typed stage graph, declared top to bottom; run serially or pipelined with equal results.

A stage is any callable. `Graph.add` returns a handle that carries the stage's output type, so the type checker finds
wrong wiring. A stage can only read existing handles, so the graph has no cycles, and declaration order is execution
order.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, overload

__all__ = ["Graph", "Node"]

A = TypeVar("A")
B = TypeVar("B")
C = TypeVar("C")
D = TypeVar("D")
E = TypeVar("E")
G = TypeVar("G")
H = TypeVar("H")
K = TypeVar("K")
P = TypeVar("P")
Q = TypeVar("Q")


class Stamped(Protocol):
    """A frame that can be named in error messages."""

    @property
    def index(self) -> int:
        """Number of the frame."""

    @property
    def stamp_ns(self) -> int:
        """Time of measurement."""


F = TypeVar("F", bound=Stamped)
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


@dataclass(frozen=True, eq=False)
class Node(Generic[R_co]):
    """Handle to one stage's output.

    Attributes:
        name: Stage name, for timing and errors.
        fn: The stage.
        inputs: Handles of its arguments, in order.
        workers: Threads. 1 keeps frames in order, for stages with state; more only for pure stages.
    """

    name: str
    fn: Callable[..., R_co]
    inputs: tuple["Node[Any]", ...] = ()
    workers: int = 1


class Graph(Generic[F]):
    """Stages over a stream of frames.

    Attributes:
        frame: Handle to the incoming frame.
        seconds: Time spent in each stage so far by name, summed over its threads.
    """

    def __init__(self, frame_type: type[F]) -> None:
        self.frame: Node[F] = Node("frame", frame_type)
        self.nodes: list[Node[Any]] = []
        self.seconds: dict[str, float] = {}
        self._clock = threading.Lock()

    @overload
    def add(self, name: str, fn: Callable[[A], R], a: Node[A], /, *, workers: int = 1) -> Node[R]: ...
    @overload
    def add(self, name: str, fn: Callable[[A, B], R], a: Node[A], b: Node[B], /, *, workers: int = 1) -> Node[R]: ...
    @overload
    def add(
        self, name: str, fn: Callable[[A, B, C], R], a: Node[A], b: Node[B], c: Node[C], /, *, workers: int = 1
    ) -> Node[R]: ...
    @overload
    def add(
        self,
        name: str,
        fn: Callable[[A, B, C, D], R],
        a: Node[A],
        b: Node[B],
        c: Node[C],
        d: Node[D],
        /,
        *,
        workers: int = 1,
    ) -> Node[R]: ...
    @overload
    def add(
        self,
        name: str,
        fn: Callable[[A, B, C, D, E], R],
        a: Node[A],
        b: Node[B],
        c: Node[C],
        d: Node[D],
        e: Node[E],
        /,
        *,
        workers: int = 1,
    ) -> Node[R]: ...
    @overload
    def add(
        self,
        name: str,
        fn: Callable[[A, B, C, D, E, G], R],
        a: Node[A],
        b: Node[B],
        c: Node[C],
        d: Node[D],
        e: Node[E],
        g: Node[G],
        /,
        *,
        workers: int = 1,
    ) -> Node[R]: ...
    @overload
    def add(
        self,
        name: str,
        fn: Callable[[A, B, C, D, E, G, H], R],
        a: Node[A],
        b: Node[B],
        c: Node[C],
        d: Node[D],
        e: Node[E],
        g: Node[G],
        h: Node[H],
        /,
        *,
        workers: int = 1,
    ) -> Node[R]: ...
    @overload
    def add(
        self,
        name: str,
        fn: Callable[[A, B, C, D, E, G, H, K], R],
        a: Node[A],
        b: Node[B],
        c: Node[C],
        d: Node[D],
        e: Node[E],
        g: Node[G],
        h: Node[H],
        k: Node[K],
        /,
        *,
        workers: int = 1,
    ) -> Node[R]: ...
    @overload
    def add(
        self,
        name: str,
        fn: Callable[[A, B, C, D, E, G, H, K, P], R],
        a: Node[A],
        b: Node[B],
        c: Node[C],
        d: Node[D],
        e: Node[E],
        g: Node[G],
        h: Node[H],
        k: Node[K],
        p: Node[P],
        /,
        *,
        workers: int = 1,
    ) -> Node[R]: ...
    @overload
    def add(
        self,
        name: str,
        fn: Callable[[A, B, C, D, E, G, H, K, P, Q], R],
        a: Node[A],
        b: Node[B],
        c: Node[C],
        d: Node[D],
        e: Node[E],
        g: Node[G],
        h: Node[H],
        k: Node[K],
        p: Node[P],
        q: Node[Q],
        /,
        *,
        workers: int = 1,
    ) -> Node[R]: ...
    def add(self, name: str, fn: Callable[..., Any], /, *inputs: Node[Any], workers: int = 1) -> Node[Any]:
        """Append a stage that reads `inputs`, and return the handle of its output.

        Raises:
            ValueError: an input belongs to another graph, or the name is taken.
        """
        known = {self.frame, *self.nodes}
        if not set(inputs) <= known:
            raise ValueError(f"stage {name}: an input does not belong to this graph")
        if any(node.name == name for node in self.nodes):
            raise ValueError(f"stage {name}: the name is taken")
        node: Node[Any] = Node(name, fn, inputs, workers)
        self.nodes.append(node)
        self.seconds[name] = 0.0
        return node

    def run(self, sink: Node[R], frames: Iterable[F]) -> Generator[R, None, None]:
        """The sink's value for each frame, in order, on the calling thread."""
        for frame in frames:
            values: dict[Node[Any], Any] = {self.frame: frame}
            for node in self.nodes:
                values[node] = self._call(node, frame, [values[i] for i in node.inputs])
            yield values[sink]

    def run_pipelined(
        self,
        sink: Node[R],
        frames: Iterable[F],
        *,
        window: int,
        weigh: Callable[[F], float] = lambda _: 0.0,
        max_weight: float = 0.0,
    ) -> Generator[R, None, None]:
        """The same values in the same order as `run`, with each stage on its own threads.

        Each stage has a first-in, first-out pool. Tasks are submitted in frame order, and each waits for its inputs.
        So a stage with one worker sees the frames in order, and there is no deadlock.

        Args:
            sink: Handle of the values to yield.
            frames: Read on the calling thread. If reading fails, the results of earlier frames come first, as in `run`.
            window: Largest number of frames in work at once.
            weigh: Weight of a frame.
            max_weight: Weight of all frames in work at once; a heavier one is in work alone.
        """
        if window < 1:
            raise ValueError(f"window: expected at least 1 frame, got {window}")
        pending: deque[tuple[float, dict[Node[Any], Future[Any]]]] = deque()
        with ExitStack() as stack:
            pools = {n: stack.enter_context(ThreadPoolExecutor(n.workers, f"lidcam-{n.name}")) for n in self.nodes}
            stack.callback(lambda: [future.cancel() for _, futures in pending for future in futures.values()])
            source_error: Exception | None = None
            source = iter(frames)
            while True:
                try:
                    frame = next(source)
                except StopIteration:
                    break
                except Exception as err:
                    source_error = err
                    break
                weight = weigh(frame)
                while pending and weight + sum(other for other, _ in pending) > max_weight:
                    yield pending.popleft()[1][sink].result()
                futures: dict[Node[Any], Future[Any]] = {self.frame: _done(frame)}
                for node in self.nodes:
                    futures[node] = pools[node].submit(
                        self._wait_and_call, node, frame, [futures[i] for i in node.inputs]
                    )
                pending.append((weight, futures))
                del frame, futures
                if len(pending) == window:
                    yield pending.popleft()[1][sink].result()
            while pending:
                yield pending.popleft()[1][sink].result()
            if source_error is not None:
                raise source_error

    def _call(self, node: Node[Any], frame: F, args: list[Any]) -> Any:
        start = time.perf_counter()
        try:
            return node.fn(*args)
        except Exception as err:
            note = f"in stage {node.name}, frame {frame.index}, stamp {frame.stamp_ns} ns"
            if not any(known.startswith("in stage") for known in getattr(err, "__notes__", ())):
                err.add_note(note)
            raise
        finally:
            with self._clock:
                self.seconds[node.name] += time.perf_counter() - start

    def _wait_and_call(self, node: Node[Any], frame: F, inputs: list[Future[Any]]) -> Any:
        return self._call(node, frame, [future.result() for future in inputs])


def _done(value: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(value)
    return future
