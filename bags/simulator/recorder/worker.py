"""The main loop of a simulation process. Nothing heavy is imported before it watches its parent."""

import contextlib
import multiprocessing
import signal
import threading
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bags.simulator.recorder.recorded import SensingTask

__all__ = ["serve"]


def serve(pipe: Connection) -> None:
    """Answer requests until the pipe closes.

    Args:
        pipe: The task comes in, then requests; measurements and errors go out.
    """
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        task: SensingTask = pipe.recv()
        from bags.simulator.recorder.sensing import Sensing
        from bags.simulator.recorder.stage import Stage

        stage = Stage(task.scenario, driven=task.driven)
        sensing = Sensing(stage, task)
        while True:
            until_ns, commands, begun_ns = pipe.recv()
            for name, command in commands.items():
                stage.traffic.command(name, command)
            stage.traffic.advance(until_ns)
            pipe.send(sensing.measure(until_ns, begun_ns=begun_ns))
            stage.forget(until_ns)
    except (EOFError, OSError):
        return
    except Exception as err:
        with contextlib.suppress(OSError):  # the parent may have failed in the same way
            pipe.send(err)


def _end_with_parent() -> None:
    """End this process when its parent is gone, however that ended: not only when the work in hand is done."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        signal.raise_signal(signal.SIGKILL)
