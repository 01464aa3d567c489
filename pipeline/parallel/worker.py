"""A process that works on frames: what it is told, how it answers, and when it ends.

It ends as soon as the other end of its socket is closed, whatever it is doing: when the run ends or fails, and when
the process that started it is killed.
"""

import gc
import os
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Any, NoReturn, cast

from pipeline.graph import Graph, Node
from pipeline.parallel.failure import Failure, failure_of
from pipeline.parallel.log import forget_log, gather_log
from pipeline.parallel.messages import Answer, Beginning, Begun, Question
from pipeline.parallel.transfer import receive, send

__all__ = ["serve", "serve_copy"]

SWITCH_S = 0.0005
"""How soon the threads that send and receive get the interpreter, for whose work the other process waits."""

BUG = 70


Made = tuple[Graph[Any], Node[Any]]
"""The stages, and the one whose output is wanted."""


def serve_copy(descriptor: int, kept_open: Sequence[int], made: Made) -> NoReturn:
    """As `serve`, in a copy of the process that reads the frames.

    Args:
        descriptor: Of the socket.
        kept_open: Descriptors of sockets that the copy closes: an end of them is seen where all copies are closed.
        made: The stages.
    """
    try:
        signal.set_wakeup_fd(-1)  # it leads to the thread of the other process that waits for signals
        gc.freeze()  # to look for garbage in what is there would copy its memory
        for other in kept_open:
            os.close(other)
        with open(os.devnull, "rb") as nothing:  # noqa: PTH123  # the name of a device
            os.dup2(nothing.fileno(), 0)
        forget_log()
        serve(descriptor, made)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(BUG)  # whatever this process was about to do is done by the other


def serve(descriptor: int, made: Made | None = None) -> None:
    """Work on frames until the socket with this descriptor is closed at its other end; does not return.

    Args:
        descriptor: Of the socket.
        made: The stages; made here if there are none.
    """
    sys.setswitchinterval(SWITCH_S)
    connection = socket.socket(fileno=descriptor)
    questions: SimpleQueue[Question] = SimpleQueue()
    answers: SimpleQueue[Begun | Answer] = SimpleQueue()
    beginning: SimpleQueue[Beginning] = SimpleQueue()
    _start("send", lambda: _send_all(connection, answers))
    _start("receive", lambda: _receive_all(connection, beginning, questions))
    _work(beginning, questions, answers, made)


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


def _receive_all(
    connection: socket.socket, beginning: SimpleQueue[Beginning], questions: SimpleQueue[Question]
) -> None:
    beginning.put(cast(Beginning, receive(connection)))
    while True:
        questions.put(cast(Question, receive(connection)))


def _send_all(connection: socket.socket, answers: SimpleQueue[Begun | Answer]) -> None:
    while True:
        answer = answers.get()
        try:
            send(connection, answer)
        except OSError:
            raise
        except Exception as err:  # an output that cannot be pickled
            number = answer.number if isinstance(answer, Answer) else 0
            send(connection, Answer(number, failure_of(err), {}))
        del answer


def _work(
    beginning: SimpleQueue[Beginning],
    questions: SimpleQueue[Question],
    answers: SimpleQueue[Begun | Answer],
    made: Made | None,
) -> None:
    told = beginning.get()
    try:
        graph, sink = made or told.make_graph()
    except Exception as err:
        answers.put(Begun(failure_of(err)))
        questions.get()  # there are none: the process ends with its socket
        return
    by_name = {node.name: node for node in graph.nodes}
    handed, free = [by_name[name] for name in told.handed], graph.parts(sink).free
    records = gather_log(told.log_levels)
    gc.freeze()
    answers.put(Begun())

    def answer(question: Question) -> Answer:
        graph.seconds = dict.fromkeys(graph.seconds, 0.0)
        values = {graph.frame: question.frame}
        outcome: tuple[Any, ...] | Failure
        try:
            graph.evaluate(free, question.frame, values)
            outcome = tuple(values[node] for node in handed)
        except Exception as err:
            outcome = failure_of(err)
        taken = {name: seconds for name, seconds in graph.seconds.items() if seconds}
        return Answer(question.number, outcome, taken, tuple(records.get() for _ in range(records.qsize())))

    while True:
        answers.put(answer(questions.get()))
