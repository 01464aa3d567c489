from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from lidcam.pipeline.graph import Graph, Node


@dataclass(frozen=True)
class Frame:
    index: int
    stamp_ns: int


def frames(count: int) -> list[Frame]:
    return [Frame(i, 1_000 * i) for i in range(count)]


class Boom(Exception):
    pass


def add_one(frame: Frame) -> int:
    return frame.index + 1


def double(value: int) -> int:
    return 2 * value


def plus(a: int, b: int) -> int:
    return a + b


def diamond() -> tuple[Graph[Frame], Node[int]]:
    graph = Graph(Frame)
    start = graph.add_stage("start", add_one, graph.frame)
    left = graph.add_stage("left", double, start)
    right = graph.add_stage("right", double, left)
    return graph, graph.add_stage("join", plus, left, right)


@pytest.mark.parametrize("count", [0, 1, 2, 17])
def test_values_come_in_order(count: int) -> None:
    graph, sink = diamond()
    assert list(graph.run(sink, frames(count))) == [6 * (i + 1) for i in range(count)]


def test_a_graph_without_stages_gives_the_frames() -> None:
    graph = Graph(Frame)
    assert list(graph.run(graph.frame, frames(3))) == frames(3)
    assert graph.parts(graph.frame) == ((), (), ())


def names(nodes: tuple[Node[object], ...]) -> list[str]:
    return [node.name for node in nodes]


def test_what_reads_an_ordered_stage_is_in_order_too() -> None:
    graph = Graph(Frame)
    start = graph.add_stage("start", add_one, graph.frame)
    inner = graph.add_stage("inner", double, start)
    graph.add_stage("nobody reads it", double, start)
    memory = graph.add_stage("memory", plus, inner, start, ordered=True)
    behind = graph.add_stage("behind", double, memory)
    aside = graph.add_stage("aside", double, inner)
    sink = graph.add_stage("sink", plus, behind, aside)
    free, handed, ordered = graph.parts(sink)
    assert names(free) == ["start", "inner", "nobody reads it", "aside"]
    assert names(handed) == ["start", "inner", "aside"]
    assert names(ordered) == ["memory", "behind", "sink"]
    assert names(graph.parts(aside).handed) == ["start", "inner", "aside"]


def test_a_graph_of_pure_stages_hands_on_its_sink() -> None:
    graph, sink = diamond()
    assert (names(graph.parts(sink).handed), graph.parts(sink).ordered) == (["join"], ())


def test_failing_stage_yields_earlier_frames_then_names_itself() -> None:
    graph = Graph(Frame)

    def fail_at_7(frame: Frame) -> int:
        if frame.index == 7:
            raise Boom
        return frame.index

    sink = graph.add_stage("after", double, graph.add_stage("boom", fail_at_7, graph.frame))
    results = graph.run(sink, frames(20))
    assert [next(results) for _ in range(7)] == [0, 2, 4, 6, 8, 10, 12]
    with pytest.raises(Boom) as caught:
        next(results)
    assert caught.value.__notes__ == ["in stage boom, frame 7, stamp 7000 ns"]


def test_what_is_done_behind_the_graph_is_timed_and_named_like_a_stage() -> None:
    graph, sink = diamond()
    for frame, _ in zip(frames(3), graph.run(sink, frames(3)), strict=True):
        with graph.stage("behind", frame):
            pass
    assert list(graph.seconds) == ["start", "left", "right", "join", "behind"]
    assert graph.seconds["behind"] > 0
    with pytest.raises(Boom) as caught, graph.stage("behind", Frame(3, 3000)):
        raise Boom
    assert caught.value.__notes__ == ["in stage behind, frame 3, stamp 3000 ns"]


def test_failing_source_yields_what_was_read() -> None:
    graph = Graph(Frame)

    def source() -> Iterator[Frame]:
        yield from frames(5)
        raise Boom

    sink = graph.add_stage("index", lambda f: f.index, graph.frame)
    results = graph.run(sink, source())
    assert [next(results) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(Boom):
        next(results)


def test_type_checker_sees_a_wrong_wiring() -> None:
    """mypy reports an ignored error that is none any more."""
    graph = Graph(Frame)
    number = graph.add_stage("number", add_one, graph.frame)
    text = graph.add_stage("text", str, number)
    graph.add_stage("too few", plus, number)  # type: ignore[arg-type]
    graph.add_stage("too many", double, number, number)  # type: ignore[arg-type]
    graph.add_stage("wrong input", double, text)  # type: ignore[arg-type]
    wrong: Node[str] = graph.add_stage("wrong output", double, number)  # type: ignore[arg-type]
    assert wrong.name == "wrong output"


def test_wrong_wiring_is_refused() -> None:
    graph, other = Graph(Frame), Graph(Frame)
    foreign = other.add_stage("foreign", add_one, other.frame)
    graph.add_stage("start", add_one, graph.frame)
    with pytest.raises(ValueError, match="does not belong to this graph"):
        graph.add_stage("next", double, foreign)
    with pytest.raises(ValueError, match="the name is taken"):
        graph.add_stage("start", add_one, graph.frame)


def test_time_is_counted_by_stage_but_for_what_only_puts_together(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = iter(range(100))
    monkeypatch.setattr("lidcam.pipeline.graph.time.perf_counter", lambda: next(seconds))
    graph = Graph(Frame)
    first = graph.add_stage("work", add_one, graph.frame)
    last = graph.add_stage("join", plus, first, first, timed=False)
    assert [*graph.run(last, frames(3))] == [2, 4, 6]
    assert graph.seconds == {"work": 3.0}
