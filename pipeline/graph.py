"""A typed stage graph, declared top to bottom; `lidcam.pipeline.parallel` shares its frames among processes.

A stage is any callable. `Graph.add_stage` returns a handle that carries the stage's output type, so the type checker
finds wrong wiring. A stage can only read existing handles, so the graph has no cycles, and declaration order is
execution order.
"""

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypedDict, TypeVar, Unpack, overload

A = TypeVar("A")
B = TypeVar("B")
C = TypeVar("C")
D = TypeVar("D")
E = TypeVar("E")
G = TypeVar("G")
H = TypeVar("H")
K = TypeVar("K")


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
    """Handle to one stage's output."""

    name: str  # Stage name, for timing and errors
    fn: Callable[..., R_co]  # The stage
    inputs: tuple["Node[Any]", ...] = ()  # Handles of its arguments, in order
    # Whether it must see all frames in their order, because it remembers something or has an effect. Other stages are
    # pure: their output depends on their inputs alone, which they do not change
    ordered: bool = False
    timed: bool = True  # Whether its time is counted; off for stages that only put outputs of others together


class How(TypedDict, total=False):
    """Options of a stage: `Node.ordered` (False unless given) and `Node.timed` (True)."""

    ordered: bool
    timed: bool


class Parts(NamedTuple):
    """The stages of a graph, by whether they may see frames in any order."""

    # Pure stages that read nothing but the frame and outputs of such stages, in their order
    free: tuple[Node[Any], ...]
    handed: tuple[Node[Any], ...]  # Those of them whose outputs the others read, or which are the sink
    ordered: tuple[Node[Any], ...]  # The other stages, in their order


class Graph(Generic[F]):
    """Stages over a stream of frames.

    Attributes:
        frame: Handle to the incoming frame.
        seconds: Time spent in each timed stage by name, summed over all processes.
    """

    def __init__(self, frame_type: type[F]) -> None:
        self.frame: Node[F] = Node("frame", frame_type)
        self.nodes: list[Node[Any]] = []
        self.seconds: dict[str, float] = {}

    # A line or two for each number of inputs.
    # fmt: off
    @overload
    def add_stage(self, name: str, fn: Callable[[A], R], a: Node[A], /, **how: Unpack[How]) -> Node[R]: ...
    @overload
    def add_stage(self, name: str, fn: Callable[[A, B], R],
            a: Node[A], b: Node[B], /, **how: Unpack[How]) -> Node[R]: ...
    @overload
    def add_stage(self, name: str, fn: Callable[[A, B, C], R],
            a: Node[A], b: Node[B], c: Node[C], /, **how: Unpack[How]) -> Node[R]: ...
    @overload
    def add_stage(self, name: str, fn: Callable[[A, B, C, D], R],
            a: Node[A], b: Node[B], c: Node[C], d: Node[D], /, **how: Unpack[How]) -> Node[R]: ...
    @overload
    def add_stage(self, name: str, fn: Callable[[A, B, C, D, E], R],
            a: Node[A], b: Node[B], c: Node[C], d: Node[D], e: Node[E], /, **how: Unpack[How]) -> Node[R]: ...
    @overload
    def add_stage(self, name: str, fn: Callable[[A, B, C, D, E, G], R],
            a: Node[A], b: Node[B], c: Node[C], d: Node[D], e: Node[E], g: Node[G],
            /, **how: Unpack[How]) -> Node[R]: ...
    @overload
    def add_stage(self, name: str, fn: Callable[[A, B, C, D, E, G, H], R],
            a: Node[A], b: Node[B], c: Node[C], d: Node[D], e: Node[E], g: Node[G], h: Node[H],
            /, **how: Unpack[How]) -> Node[R]: ...
    @overload
    def add_stage(self, name: str, fn: Callable[[A, B, C, D, E, G, H, K], R],
            a: Node[A], b: Node[B], c: Node[C], d: Node[D], e: Node[E], g: Node[G], h: Node[H], k: Node[K],
            /, **how: Unpack[How]) -> Node[R]: ...
    # fmt: on
    def add_stage(
        self, name: str, fn: Callable[..., Any], /, *inputs: Node[Any], ordered: bool = False, timed: bool = True
    ) -> Node[Any]:
        """Append a stage that reads `inputs`, and return the handle of its output.

        Raises:
            ValueError: an input belongs to another graph, or the name is taken.
        """
        known = {self.frame, *self.nodes}
        if not set(inputs) <= known:
            raise ValueError(f"stage {name}: an input does not belong to this graph")
        if any(node.name == name for node in self.nodes):
            raise ValueError(f"stage {name}: the name is taken")
        node: Node[Any] = Node(name, fn, inputs, ordered, timed)
        self.nodes.append(node)
        if timed:
            self.seconds[name] = 0.0
        return node

    @contextmanager
    def stage(self, name: str, frame: Stamped, *, timed: bool = True) -> Iterator[None]:
        """Count the time of the block, in the graph or behind it, as a stage's; name stage and frame in its errors."""
        start = time.perf_counter()
        try:
            yield
        except Exception as err:
            note = f"in stage {name}, frame {frame.index}, stamp {frame.stamp_ns} ns"
            if not any(known.startswith("in stage") for known in getattr(err, "__notes__", ())):
                err.add_note(note)
            raise
        finally:
            if timed:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def run(self, sink: Node[R], frames: Iterable[F]) -> Generator[R, None, None]:
        """The sink's value for each frame, in order, one stage after another."""
        for frame in frames:
            yield self.evaluate(self.nodes, frame)[sink]

    def evaluate(
        self, nodes: Sequence[Node[Any]], frame: F, known: Iterable[tuple[Node[Any], Any]] = ()
    ) -> dict[Node[Any], Any]:
        """The outputs by stage, when some stages are called for a frame, in order; those of others may be known."""
        values: dict[Node[Any], Any] = {self.frame: frame, **dict(known)}
        for node in nodes:
            with self.stage(node.name, frame, timed=node.timed):
                values[node] = node.fn(*(values[one] for one in node.inputs))
        return values

    def parts(self, sink: Node[Any]) -> Parts:
        """The stages by whether they may see the frames in any order, for a run that yields the sink's values."""
        free: list[Node[Any]] = []
        for node in self.nodes:
            if not node.ordered and {*node.inputs} <= {self.frame, *free}:
                free.append(node)
        ordered = [node for node in self.nodes if node not in free]
        wanted = {sink, *(one for node in ordered for one in node.inputs)}
        return Parts(tuple(free), tuple(node for node in free if node in wanted), tuple(ordered))
