"""Sensors spread over worker processes, to get around the interpreter lock.

Each process simulates the traffic itself, which is cheap: equal steps and commands give equal traffic. Only commands go
in, and only finished messages come out.
"""

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection

from lidcam.bags.simulator.recorder.recorded import Measured, SensingTask
from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand
from lidcam.pipeline.core.ending import undone_at_once
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.parallel.process import signals_blocked


class SensingProcess:
    """A worker process with some of the sensors."""

    def __init__(self, task: SensingTask) -> None:
        context = multiprocessing.get_context("spawn")  # threads of the libraries do not survive a fork
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, task), daemon=True)
        resource_tracker.ensure_running()  # else it is started with the process, and unblocks signals
        with signals_blocked():
            self.process.start()
        theirs.close()
        self.pid = self.process.pid or 0

    def ask(self, until_ns: int, commands: Mapping[str, AckermannCommand], *, start_limit_ns: int) -> None:
        """Start a step: apply commands, advance to a time and measure; see `Sensing.measure`."""
        try:
            self._pipe.send((until_ns, dict(commands), start_limit_ns))
        except OSError as err:
            raise self._death() from err

    def answer(self) -> Sequence[Measured]:
        """The measurements of the last `ask`.

        Raises:
            LidcamError: the process has died, or failed with an error of its own.
        """
        try:
            answer: Sequence[Measured] | BaseException = self._pipe.recv()
        except (EOFError, OSError) as err:
            raise self._death() from err
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def close(self) -> None:
        """End the process, which ends by itself at end of file."""
        self._pipe.close()
        self.process.join(1.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def _death(self) -> LidcamError:
        self.process.join(1.0)
        code = self.process.exitcode
        return LidcamError(
            f"a simulation process died with exit code {code}, perhaps for lack of memory; try --workers 1"
        )


@contextmanager
def sensing_process(task: SensingTask) -> Iterator[SensingProcess]:
    """A worker process that ends with the block."""
    worker = SensingProcess(task)
    try:
        with undone_at_once(worker.process.kill):  # it may be in a step, or load libraries
            yield worker
    finally:
        worker.close()


def _serve(pipe: Connection, task: SensingTask) -> None:
    """The main loop of a process: requests come in, measurements and errors go out, until the pipe is closed."""
    try:
        from lidcam.bags.simulator.recorder.sensing import Sensing  # Open3D, which this module does without
        from lidcam.bags.simulator.recorder.stage import Stage

        stage = Stage(task.scenario, driven=task.driven)
        sensing = Sensing(stage, task)
        while True:
            until_ns, commands, start_limit_ns = pipe.recv()
            for name, command in commands.items():
                stage.traffic.command(name, command)
            stage.traffic.advance(until_ns)
            pipe.send(sensing.measure(until_ns, start_limit_ns=start_limit_ns))
            stage.forget(until_ns)
    except (EOFError, OSError):
        return
    except Exception as err:
        with suppress(OSError):  # the parent may have failed in the same way
            pipe.send(err)
