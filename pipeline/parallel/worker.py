"""A process that works on frames, from its own side.

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

from pipeline.graph import Graph, Node
from pipeline.parallel.protocol import Answer, Failure, Question, Ready, Setup, failure_of, gather_log
from pipeline.parallel.transfer import receive, send

__all__ = ["serve"]

SWITCH_S = 0.0005
"""Time after which the threads that send and receive get the interpreter: the other process waits for them."""

BUG = 70

Stages = tuple[Graph[Any], Node[Any]]
"""The stages of a frame, and the one whose output is wanted."""


def serve(descriptor: int, stages: Stages | None = None) -> NoReturn:
    """Work on frames until the socket with this descriptor is closed at its other end.

    Args:
        descriptor: File descriptor of a connected socket.
        stages: The stages; None to make them here.
    """
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
            send(connection, Answer(number, failure_of(err), {}))
        del answer


def _work(inbox: SimpleQueue[object], outbox: SimpleQueue[Ready | Answer], stages: Stages | None) -> NoReturn:
    setup = cast(Setup, inbox.get())
    try:
        graph, sink = stages or setup.make_graph()
    except Exception as err:
        outbox.put(Ready(failure_of(err)))
        threading.Event().wait()  # the process ends with its socket
        raise
    by_name = {node.name: node for node in graph.nodes}
    handed, free = [by_name[name] for name in setup.handed], graph.parts(sink).free
    records = gather_log(setup.log_levels)
    gc.freeze()  # libraries stay: looking for garbage among them takes 5 ms a frame
    outbox.put(Ready())

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
        outbox.put(answer(cast(Question, inbox.get())))
