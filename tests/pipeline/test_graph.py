import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mypy.api
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.graph import Graph, Node


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
    start = graph.add("start", add_one, graph.frame)
    left = graph.add("left", double, start, workers=3)
    right = graph.add("right", double, left)
    return graph, graph.add("join", plus, left, right)


@pytest.mark.parametrize("count", [0, 1, 2, 17])
@pytest.mark.parametrize("window", [1, 2, 5])
def test_pipelined_equals_serial(count: int, window: int) -> None:
    graph, sink = diamond()
    expected = [6 * (i + 1) for i in range(count)]
    assert list(graph.run(sink, frames(count))) == expected
    assert list(graph.run_pipelined(sink, frames(count), window=window)) == expected


def test_a_graph_without_stages_gives_the_frames() -> None:
    graph = Graph(Frame)
    assert list(graph.run_pipelined(graph.frame, frames(3), window=2)) == list(graph.run(graph.frame, frames(3)))


@given(
    stages=st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9), st.integers(1, 3), st.integers(0, 2)), max_size=6),
    count=st.integers(0, 12),
    window=st.integers(1, 6),
)
@settings(max_examples=40, deadline=None)
def test_pipelined_equals_serial_on_random_graphs(
    stages: list[tuple[int, int, int, int]], count: int, window: int
) -> None:
    graph = Graph(Frame)
    nodes: list[Node[int]] = [graph.add("first", add_one, graph.frame)]

    def slow_mix(milliseconds: int) -> Callable[[int, int], int]:
        def mix(a: int, b: int) -> int:
            time.sleep(milliseconds / 2000)
            return 3 * a - b

        return mix

    for number, (a, b, workers, milliseconds) in enumerate(stages):
        inputs = nodes[a % len(nodes)], nodes[b % len(nodes)]
        nodes.append(graph.add(f"s{number}", slow_mix(milliseconds), *inputs, workers=workers))
    serial = list(graph.run(nodes[-1], frames(count)))
    assert list(graph.run_pipelined(nodes[-1], frames(count), window=window)) == serial


def test_one_worker_stage_sees_frames_in_order() -> None:
    graph, seen = Graph(Frame), list[int]()

    def remember(value: int) -> int:
        seen.append(value)
        return value

    def dawdle(frame: Frame) -> int:
        time.sleep(0.002 * (frame.index % 3))
        return frame.index

    uneven = graph.add("uneven", dawdle, graph.frame, workers=3)
    sink = graph.add("remember", remember, uneven)
    assert list(graph.run_pipelined(sink, frames(20), window=6)) == list(range(20)) == seen


@pytest.mark.parametrize("window", [1, 4])
def test_at_most_window_frames_are_in_work(window: int) -> None:
    graph, alive, peak, lock = Graph(Frame), set[int](), [0], threading.Lock()

    def source() -> Iterator[Frame]:
        for frame in frames(20):
            with lock:
                alive.add(frame.index)
                peak[0] = max(peak[0], len(alive))
            yield frame

    def dawdle(frame: Frame) -> int:
        time.sleep(0.001)
        return frame.index

    sink = graph.add("slow", dawdle, graph.frame)
    for index in graph.run_pipelined(sink, source(), window=window):
        with lock:
            alive.discard(index)
    assert peak[0] <= window + 1  # the one that is being handed over, too


def runs(graph: Graph[Frame], sink: Node[Any], source: Any) -> dict[str, Iterator[Any]]:
    return {"serial": graph.run(sink, source()), "pipelined": graph.run_pipelined(sink, source(), window=3)}


@pytest.mark.parametrize("kind", ["serial", "pipelined"])
def test_failing_stage_yields_earlier_frames_then_names_itself(kind: str) -> None:
    graph = Graph(Frame)

    def fail_at_7(frame: Frame) -> int:
        if frame.index == 7:
            raise Boom
        return frame.index

    sink = graph.add("after", double, graph.add("boom", fail_at_7, graph.frame))
    results = runs(graph, sink, lambda: iter(frames(20)))[kind]
    assert [next(results) for _ in range(7)] == [0, 2, 4, 6, 8, 10, 12]
    with pytest.raises(Boom) as caught:
        next(results)
    assert caught.value.__notes__ == ["in stage boom, frame 7, stamp 7000 ns"]


@pytest.mark.parametrize("kind", ["serial", "pipelined"])
def test_failing_source_yields_what_was_read(kind: str) -> None:
    graph = Graph(Frame)

    def source() -> Iterator[Frame]:
        yield from frames(5)
        raise Boom

    sink = graph.add("index", lambda f: f.index, graph.frame)
    results = runs(graph, sink, source)[kind]
    assert [next(results) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(Boom):
        next(results)


def test_closing_early_leaves_no_thread() -> None:
    graph, sink = diamond()
    before = threading.active_count()
    results = graph.run_pipelined(sink, frames(100), window=4)
    next(results)
    results.close()
    assert threading.active_count() == before


def test_wrong_wiring_is_refused() -> None:
    graph, other = Graph(Frame), Graph(Frame)
    foreign = other.add("foreign", add_one, other.frame)
    graph.add("start", add_one, graph.frame)
    with pytest.raises(ValueError, match="does not belong to this graph"):
        graph.add("next", double, foreign)
    with pytest.raises(ValueError, match="the name is taken"):
        graph.add("start", add_one, graph.frame)
    with pytest.raises(ValueError, match="at least 1 frame"):
        next(graph.run_pipelined(graph.nodes[0], frames(1), window=0))


def test_time_is_counted_per_stage() -> None:
    graph = Graph(Frame)
    sink = graph.add("sleep", lambda _: time.sleep(0.005), graph.frame)
    list(graph.run(sink, frames(3)))
    assert graph.seconds["sleep"] >= 0.015


WIRING = """
from pipeline.graph import Graph, Node

class Frame:
    index = 0
    stamp_ns = 0

graph = Graph(Frame)
number: Node[int] = graph.add("number", lambda frame: frame.index, graph.frame)
text: Node[str] = graph.add("text", lambda frame: "", graph.frame)

def four(a: int, b: int, c: int, d: int) -> str: return ""
def five(a: int, b: int, c: int, d: int, e: int) -> str: return ""
def six(a: int, b: int, c: int, d: int, e: int, f: int) -> str: return ""
"""


def test_type_checker_sees_a_wrong_wiring(tmp_path: Path) -> None:
    lines, faulty = WIRING.splitlines(), set()
    for count, stage in ((4, "four"), (5, "five"), (6, "six")):
        inputs = ["number"] * count
        lines.append(f"right_{stage}: Node[str] = graph.add('{stage}', {stage}, {', '.join(inputs)})")
        for wrong in (inputs[1:], [*inputs, "number"], [*inputs[1:], "text"]):
            lines.append(f"graph.add('{stage}', {stage}, {', '.join(wrong)})")
            faulty.add(len(lines))
        lines.append(f"wrong_{stage}: Node[int] = graph.add('{stage}', {stage}, {', '.join(inputs)})")
        faulty.add(len(lines))
    snippet = tmp_path / "wiring.py"
    snippet.write_text("\n".join(lines), encoding="utf-8")
    config = Path(__file__).parents[2] / "pyproject.toml"
    report, _, _ = mypy.api.run([f"--config-file={config}", f"--cache-dir={os.devnull}", str(snippet)])
    assert {int(line.split(":")[1]) for line in report.splitlines() if ": error:" in line} == faulty, report


@pytest.mark.parametrize(("max_weight", "most"), [(0.0, 1), (3.0, 3), (100.0, 4)])
def test_frames_in_work_weigh_no_more_than_they_may(max_weight: float, most: int) -> None:
    graph = Graph(Frame)
    sink = graph.add("add one", add_one, graph.frame)
    taken = 0

    def source() -> Iterator[Frame]:
        nonlocal taken
        for frame in frames(12):
            taken += 1
            yield frame

    ahead = []
    for done, _ in enumerate(
        graph.run_pipelined(sink, source(), window=4, weigh=lambda _: 1.0, max_weight=max_weight), 1
    ):
        ahead.append(taken - done + 1)
    assert len(ahead) == 12
    assert max(ahead) <= most + 1  # one is read before it is weighed
