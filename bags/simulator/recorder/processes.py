"""Sensors spread over worker processes, to get around the interpreter lock.

Each process simulates the traffic itself, which is cheap: equal steps and commands give equal traffic. Only commands go
in, and only finished messages come out.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING

from lidcam.bags.simulator.recorder.recorded import Measured, SensingTask
from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.parallel.pool import process_pool
from lidcam.pipeline.parallel.process import signals_blocked

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.sensing import Sensing
    from lidcam.bags.simulator.recorder.stage import Stage

DEATH = (
    "a simulation process died, perhaps for lack of memory: try --workers 1; or it is called in a script without "
    '`if __name__ == "__main__":`'
)


class SensingProcess:
    """A worker process with some of the sensors; it ends with `close`, or with this process."""

    def __init__(self, task: SensingTask) -> None:
        self._pool = process_pool(1)
        with signals_blocked():  # Ctrl-C and a closed terminal are this process's business
            self._steps: list[Future[Sequence[Measured]]] = [self._pool.submit(_begin, task)]

    def ask(self, until_ns: int, commands: Mapping[str, AckermannCommand], *, start_limit_ns: int) -> None:
        """Start a step: apply commands, advance, and measure (`Sensing.measure`); raises LidcamError if it has died."""
        try:
            self._steps.append(self._pool.submit(_measured, until_ns, dict(commands), start_limit_ns))
        except BrokenProcessPool as err:
            raise LidcamError(DEATH) from err

    def answer(self) -> Sequence[Measured]:
        """The measurements since the last answer; raises LidcamError if the process has died, or failed."""
        steps, self._steps = self._steps, []
        try:
            return [one for step in steps for one in step.result()]
        except BrokenProcessPool as err:
            raise LidcamError(DEATH) from err

    def close(self) -> None:
        """End the process."""
        self._pool.shutdown(cancel_futures=True)


_running: "list[tuple[Stage, Sensing]]" = []
"""The stage and the sensors of a worker process."""


def _begin(task: SensingTask) -> Sequence[Measured]:
    from lidcam.bags.simulator.recorder.sensing import Sensing  # Open3D, which this module does without
    from lidcam.bags.simulator.recorder.stage import Stage

    stage = Stage(task.scenario, driven=task.driven)
    _running.append((stage, Sensing(stage, task)))
    return ()


def _measured(until_ns: int, commands: Mapping[str, AckermannCommand], start_limit_ns: int) -> Sequence[Measured]:
    ((stage, sensing),) = _running
    for name, command in commands.items():
        stage.traffic.command(name, command)
    stage.traffic.advance(until_ns)
    measured = sensing.measure(until_ns, start_limit_ns=start_limit_ns)
    stage.forget(until_ns)
    return measured
