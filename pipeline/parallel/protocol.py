"""Messages between the processes of a run: frames and their results, errors, and records of the log."""

import logging
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from logging import LogRecord
from logging.handlers import QueueHandler
from queue import SimpleQueue
from typing import Any, NamedTuple

from pipeline.core.errors import LidcamError, is_short_memory
from pipeline.graph import Graph, Node
from pipeline.parallel.transfer import arrived

__all__ = [
    "Answer",
    "Failure",
    "MakeGraph",
    "Question",
    "Ready",
    "Setup",
    "WorkerTraceback",
    "failure_of",
    "gather_log",
    "log_levels",
]

MakeGraph = Callable[[], tuple[Graph[Any], Node[Any]]]
"""Makes the stages of a frame, and the one whose output is wanted; can be pickled."""


class WorkerTraceback(Exception):
    """Traceback in another process; the cause of the error that is raised here."""


@dataclass(frozen=True, slots=True)
class Failure:
    """An error as it travels.

    Attributes:
        error: The error, with its notes; it can be pickled.
        trace: Its traceback as text.
    """

    error: Exception
    trace: str

    def raised(self) -> Exception:
        """The error, to be raised in this process."""
        self.error.__cause__ = WorkerTraceback(f"\n{self.trace}")
        return self.error


class Setup(NamedTuple):
    """The first message to a process.

    Attributes:
        make_graph: Makes the stages of the process that reads the frames anew, in the same order.
        handed: Names of the stages whose outputs are wanted.
        log_levels: See `log_levels`.
    """

    make_graph: MakeGraph
    handed: tuple[str, ...]
    log_levels: Mapping[str, int]


class Ready(NamedTuple):
    """A process has its stages, or has failed to make them."""

    failure: Failure | None = None


class Question(NamedTuple):
    """A frame to work on, and its place among all frames."""

    number: int
    frame: Any


class Answer(NamedTuple):
    """Result of a frame.

    Attributes:
        number: Place of the frame among all frames.
        outcome: The outputs that are handed on, or an error.
        seconds: Time spent by stage.
        records: Records that the stages logged.
    """

    number: int
    outcome: tuple[Any, ...] | Failure
    seconds: Mapping[str, float]
    records: tuple[LogRecord, ...] = ()


def failure_of(err: Exception) -> Failure:
    """The error to send; one that cannot be pickled becomes a `RuntimeError` with its type and text."""
    return Failure(_portable(err), "".join(traceback.format_exception(err)))


def _portable(err: Exception) -> Exception:
    if is_short_memory(err) and not isinstance(err, LidcamError):
        return _noted(MemoryError(str(err)), err)  # whatever a library says with an error of its own
    try:
        copy = arrived(err)
    except Exception:
        copy = None
    if type(copy) is type(err) and str(copy) == str(err):
        return err
    return _noted(RuntimeError(f"{type(err).__qualname__}: {err}"), err)


def _noted(error: Exception, original: Exception) -> Exception:
    for note in getattr(original, "__notes__", ()):
        error.add_note(note)
    return error


def log_levels() -> Mapping[str, int]:
    """The levels of the loggers that have one, by name; the root has none."""
    root = logging.getLogger()
    named = {
        name: logger.level for name, logger in root.manager.loggerDict.items() if isinstance(logger, logging.Logger)
    }
    return {"": root.level, **{name: level for name, level in sorted(named.items()) if level != logging.NOTSET}}


def gather_log(levels: Mapping[str, int]) -> SimpleQueue[LogRecord]:
    """A queue of all records that are logged from now on, at the given levels."""
    records: SimpleQueue[LogRecord] = SimpleQueue()
    logging.getLogger().addHandler(QueueHandler(records))
    for name, level in levels.items():
        logging.getLogger(name or None).setLevel(level)
    return records
