"""A process that works on frames, from its own side, and the messages between the processes of a run.

It ends as soon as the other end of its socket is closed, whatever it is doing: when the run ends or fails, and when
the process that started it is killed.
"""

import gc
import logging
import os
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from logging import LogRecord
from logging.handlers import QueueHandler
from queue import SimpleQueue
from typing import Any, NamedTuple, NoReturn, cast

from lidcam.pipeline.core.errors import LidcamError, is_short_memory
from lidcam.pipeline.graph import Graph, Node
from lidcam.pipeline.parallel.transfer import arrived, receive, send

SWITCH_S = 0.0005
"""Time after which the threads that send and receive get the interpreter: the other process waits for them."""

BUG = 70

Stages = tuple[Graph[Any], Node[Any]]
"""The stages of a frame, and the one whose output is wanted."""

MakeGraph = Callable[[], Stages]
"""Makes the stages of a frame; can be pickled."""


class WorkerTraceback(Exception):
    """Traceback in another process; the cause of the error that is raised here."""


@dataclass(frozen=True, slots=True)
class Failure:
    """An error that can be pickled, with its notes, and its traceback as text."""

    error: Exception
    trace: str

    @classmethod
    def of(cls, err: Exception) -> "Failure":
        """The error to send; one that cannot be pickled becomes a `RuntimeError` with its type and text."""
        if is_short_memory(err) and not isinstance(err, LidcamError):
            sent: Exception = MemoryError(str(err))  # whatever a library says with an error of its own
        else:
            try:
                copy = arrived(err)
            except Exception:
                copy = None
            is_whole = type(copy) is type(err) and str(copy) == str(err)
            sent = err if is_whole else RuntimeError(f"{type(err).__qualname__}: {err}")
        for note in getattr(err, "__notes__", ()) if sent is not err else ():
            sent.add_note(note)
        return cls(sent, "".join(traceback.format_exception(err)))

    def raised(self) -> Exception:
        """The error, to be raised in this process."""
        self.error.__cause__ = WorkerTraceback(f"\n{self.trace}")
        return self.error


class Setup(NamedTuple):
    """The first message to a process."""

    make_graph: MakeGraph  # Makes the stages of the process that reads the frames anew, in the same order
    handed: tuple[str, ...]  # Names of the stages whose outputs are wanted
    log_levels: Mapping[str, int]  # See `log_levels`


class Ready(NamedTuple):
    """A process has its stages, or has failed to make them."""

    failure: Failure | None = None


class Question(NamedTuple):
    """A frame to work on, and its place among all frames."""

    number: int
    frame: Any


class Answer(NamedTuple):
    """Result of a frame: the outputs that are handed on, or an error; seconds by stage; records that stages logged."""

    number: int
    outcome: tuple[Any, ...] | Failure
    seconds: Mapping[str, float]
    records: tuple[LogRecord, ...] = ()


def log_levels() -> Mapping[str, int]:
    """The levels of the loggers that have one, by name; the root has none."""
    root = logging.getLogger()
    loggers = {name: one for name, one in root.manager.loggerDict.copy().items() if isinstance(one, logging.Logger)}
    return {"": root.level, **{name: logger.level for name, logger in sorted(loggers.items()) if logger.level}}


def serve(descriptor: int, stages: Stages | None = None) -> NoReturn:
    """Work on frames until the other end of this socket is closed; without stages, they are made here."""
    sys.setswitchinterval(SWITCH_S)
    connection = socket.socket(fileno=descriptor)
    inbox: SimpleQueue[object] = SimpleQueue()
    outbox: SimpleQueue[Ready | Answer] = SimpleQueue()
    _start("send", lambda: _send_all(connection, outbox))
    _start("receive", lambda: _receive_all(connection, inbox))
    _work(inbox, outbox, stages)


def _start(name: str, run: Callable[[], None]) -> None:
    """Run on a thread of its own, and end the process with it."""

    def end_after() -> None:
        code = 0
        try:
            run()
        except (EOFError, OSError):
            pass  # nobody is at the other end any more
        except BaseException:
            code = BUG
            traceback.print_exc()
        finally:
            os._exit(code)

    threading.Thread(target=end_after, name=name, daemon=True).start()


def _receive_all(connection: socket.socket, inbox: SimpleQueue[object]) -> None:
    while True:
        inbox.put(receive(connection))


def _send_all(connection: socket.socket, outbox: SimpleQueue[Ready | Answer]) -> None:
    while True:
        answer = outbox.get()
        try:
            send(connection, answer)
        except OSError:
            raise
        except Exception as err:  # an output that cannot be pickled
            number = answer.number if isinstance(answer, Answer) else 0
            send(connection, Answer(number, Failure.of(err), {}))
        del answer


def _work(inbox: SimpleQueue[object], outbox: SimpleQueue[Ready | Answer], stages: Stages | None) -> NoReturn:
    setup = cast(Setup, inbox.get())
    try:
        graph, sink = stages or setup.make_graph()
    except Exception as err:
        outbox.put(Ready(Failure.of(err)))
        threading.Event().wait()  # the process ends with its socket
        raise
    by_name = {node.name: node for node in graph.nodes}
    handed, free = [by_name[name] for name in setup.handed], graph.parts(sink).free
    records: SimpleQueue[LogRecord] = SimpleQueue()
    logging.getLogger().addHandler(QueueHandler(records))
    for name, level in setup.log_levels.items():
        logging.getLogger(name or None).setLevel(level)
    gc.freeze()  # libraries stay: looking for garbage among them takes 5 ms a frame
    outbox.put(Ready())

    def answer(question: Question) -> Answer:
        graph.seconds = dict.fromkeys(graph.seconds, 0.0)
        outcome: tuple[Any, ...] | Failure
        try:
            values = graph.evaluate(free, question.frame)
            outcome = tuple(values[node] for node in handed)
        except Exception as err:
            outcome = Failure.of(err)
        taken = {name: seconds for name, seconds in graph.seconds.items() if seconds}
        return Answer(question.number, outcome, taken, tuple(records.get() for _ in range(records.qsize())))

    while True:
        outbox.put(answer(cast(Question, inbox.get())))
