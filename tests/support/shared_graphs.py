"""Graphs that several processes can make: frames with a number, stages that work, fail, log and die."""

import logging
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.graph import Graph, Node

POINTS = 30_000
logger = logging.getLogger("lidcam.pipeline.test")


@dataclass(frozen=True)
class Frame:
    index: int
    stamp_ns: int
    data: memoryview | bytes
    reader: int = 0


@dataclass(frozen=True)
class Seen:
    """What became of a frame: the process that worked on it, its points, and the sum of all frames so far."""

    index: int
    pid: int
    points: npt.NDArray[np.float32]
    total: int


class Unsendable(Exception):
    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def frames(count: int) -> list[Frame]:
    return [Frame(i, 1_000 * i, bytes([i % 256]) * (40_000 + i), os.getpid()) for i in range(count)]


def _message_error(_: Frame) -> object:
    raise MessageError("/points: bad")


def _unsendable_error(_: Frame) -> object:
    raise Unsendable(1, 2)


def _no_memory(_: Frame) -> object:
    return np.empty(1 << 60, np.uint8)


def _unsendable_output(_: Frame) -> object:
    return lambda: 0


def _log(frame: Frame) -> object:
    logger.debug("frame %d", frame.index)
    logger.info("frame %d: %s", frame.index, "told")
    return None


def _die(frame: Frame) -> object:
    if os.getpid() != frame.reader:
        os.kill(os.getpid(), signal.SIGKILL)
    return None


DEEDS: dict[str, Callable[[Frame], object]] = {
    deed.__name__.removeprefix("_"): deed
    for deed in (_message_error, _unsendable_error, _no_memory, _unsendable_output, _log, _die)
}


def make_graph(deed: str = "", first: int = 0) -> tuple[Graph[Frame], Node[Seen]]:
    """Pure stages, of which one does something from frame `first` on, and one that remembers."""
    graph = Graph(Frame)
    total = 0

    def work(frame: Frame) -> tuple[int, npt.NDArray[np.float32]]:
        time.sleep(0.002 * (frame.index % 3))
        return os.getpid(), np.full((POINTS, 3), sum(frame.data[:3]), np.float32) + frame.index

    def do(frame: Frame) -> object:
        return DEEDS[deed](frame) if deed and frame.index >= first else None

    def remember(frame: Frame) -> int:
        nonlocal total
        total += frame.index
        return total

    def collect(frame: Frame, worked: tuple[int, npt.NDArray[np.float32]], total: int, _: object) -> Seen:
        return Seen(frame.index, *worked, total)

    worked = graph.add_stage("work", work, graph.frame)
    done = graph.add_stage("do", do, graph.frame)
    remembered = graph.add_stage("remember", remember, graph.frame, ordered=True)
    return graph, graph.add_stage("collect", collect, graph.frame, worked, remembered, done)


def make_nothing() -> tuple[Graph[Frame], Node[Seen]]:
    """Fails in every process but the first."""
    raise MessageError("the network cannot be loaded here")


def make_random(stages: tuple[tuple[int, int, bool], ...]) -> tuple[Graph[Frame], Node[int]]:
    """Each stage mixes two of those before it; an ordered one adds what it has mixed so far."""
    graph = Graph(Frame)
    nodes: list[Node[int]] = [graph.add_stage("first", lambda frame: frame.index + 1, graph.frame)]

    def plain(a: int, b: int) -> int:
        return (3 * a - b) % 1_000_003

    def remembering() -> Callable[[int, int], int]:
        seen = 0

        def mix(a: int, b: int) -> int:
            nonlocal seen
            seen = (2 * seen + 3 * a - b) % 1_000_003
            return seen

        return mix

    for number, (a, b, ordered) in enumerate(stages):
        fn = remembering() if ordered else plain
        nodes.append(graph.add_stage(f"s{number}", fn, nodes[a % len(nodes)], nodes[b % len(nodes)], ordered=ordered))
    return graph, nodes[-1]
