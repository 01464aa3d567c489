"""A process that works on frames: what it is told, how it answers, and when it ends.

It ends as soon as the other end of its socket is closed, whatever it is doing: when the run ends or fails, and when
the process that started it is killed.
"""

import gc
import os
import socket
import sys
import threading
import traceback
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, NoReturn, cast

from pipeline.parallel.messages import Answer, Beginning, Begun, Failure, Question, failure_of, gather_log
from pipeline.parallel.transfer import receive, send

__all__ = ["serve"]

SWITCH_S = 0.0005
"""How soon the threads that send and receive get the interpreter, for whose work the other process waits."""

BUG = 70


def serve(descriptor: int) -> NoReturn:
    """Work on frames until the socket with this descriptor is closed at its other end."""
    sys.setswitchinterval(SWITCH_S)
    connection = socket.socket(fileno=descriptor)
    told: SimpleQueue[object] = SimpleQueue()
    answers: SimpleQueue[Begun | Answer] = SimpleQueue()
    _start("send", lambda: _send_all(connection, answers))
    _start("receive", lambda: _receive_all(connection, told))
    _work(told, answers)


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


def _receive_all(connection: socket.socket, told: SimpleQueue[object]) -> None:
    while True:
        told.put(receive(connection))


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


def _work(told: SimpleQueue[object], answers: SimpleQueue[Begun | Answer]) -> NoReturn:
    beginning = cast(Beginning, told.get())
    try:
        graph, sink = beginning.make_graph()
    except Exception as err:
        answers.put(Begun(failure_of(err)))
        threading.Event().wait()  # the process ends with its socket
        raise
    by_name = {node.name: node for node in graph.nodes}
    handed, free = [by_name[name] for name in beginning.handed], graph.parts(sink).free
    records = gather_log(beginning.log_levels)
    gc.freeze()  # libraries stay: looking for garbage among them takes 5 ms a frame
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
        answers.put(answer(cast(Question, told.get())))
