"""What the processes of a run tell each other."""

from collections.abc import Callable, Mapping
from logging import LogRecord
from typing import Any, NamedTuple

from pipeline.graph import Graph, Node
from pipeline.parallel.failure import Failure

__all__ = ["Answer", "Beginning", "Begun", "MakeGraph", "Question"]

MakeGraph = Callable[[], tuple[Graph[Any], Node[Any]]]
"""Makes the stages of a frame, and the one whose output is wanted; can be pickled."""


class Beginning(NamedTuple):
    """The first thing that a process is told.

    Attributes:
        make_graph: Makes the same stages as in the process that reads the frames, and in the same order.
        handed: Names of the stages whose outputs are wanted.
        log_levels: Levels of the loggers by name; the root has none.
    """

    make_graph: MakeGraph
    handed: tuple[str, ...]
    log_levels: Mapping[str, int]


class Begun(NamedTuple):
    """A process has its stages, or has failed to make them.

    Attributes:
        failure: Why it has none; None if it has.
    """

    failure: Failure | None = None


class Question(NamedTuple):
    """A frame to work on.

    Attributes:
        number: Its place among all frames.
        frame: What stages read of it.
    """

    number: int
    frame: Any


class Answer(NamedTuple):
    """What came of a frame.

    Attributes:
        number: Its place among all frames.
        outcome: The outputs that are handed on, or an error.
        seconds: Time spent by stage.
        records: What the stages logged.
    """

    number: int
    outcome: tuple[Any, ...] | Failure
    seconds: Mapping[str, float]
    records: tuple[LogRecord, ...] = ()
