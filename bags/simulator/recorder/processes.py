"""Sensors spread over worker processes, to get around the interpreter lock.

Each process simulates the traffic itself, which is cheap: equal steps and commands give equal traffic. Only commands go
in, and only finished messages come out.
"""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING

from lidcam.bags.simulator.recorder.recorded import Measured, SensingTask
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario, LidarScenario
from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.ros.typestores import RosVersion
from lidcam.pipeline.parallel.pool import process_pool
from lidcam.pipeline.parallel.process import signals_blocked
from lidcam.readers.velodyne.models import MODELS

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.sensing import Sensing
    from lidcam.bags.simulator.recorder.simulation import Simulation
    from lidcam.bags.simulator.recorder.stage import Stage


class SensingProcess:
    """A worker process with some of the sensors; it ends with `close`, or with this process."""

    def __init__(self, task: SensingTask) -> None:
        self._pool = process_pool(1)
        with signals_blocked():  # Ctrl-C and a closed terminal are this process's business
            self._steps: list[Future[Sequence[Measured]]] = [self._pool.submit(_begin, task)]

    def ask(self, until_ns: int, commands: Mapping[str, AckermannCommand], *, start_limit_ns: int) -> None:
        """Start a step: apply commands, advance to a time and measure; see `Sensing.measure`.

        Raises:
            LidcamError: the process has died.
        """
        try:
            self._steps.append(self._pool.submit(_measured, until_ns, dict(commands), start_limit_ns))
        except BrokenProcessPool as err:
            raise _death() from err

    def answer(self) -> Sequence[Measured]:
        """The measurements since the last answer.

        Raises:
            LidcamError: the process has died, or failed with an error of its own.
        """
        steps, self._steps = self._steps, []
        try:
            return [one for step in steps for one in step.result()]
        except BrokenProcessPool as err:
            raise _death() from err

    def close(self) -> None:
        """End the process."""
        self._pool.shutdown(cancel_futures=True)


def _death() -> LidcamError:
    return LidcamError("a simulation process died, perhaps for lack of memory; try --workers 1")


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


BEAM_COST_US, PIXEL_COST_US, MOVING_PIXEL_COST_US = 0.8, 0.05, 1.1
"""Rough costs; a moving camera must render everything anew."""

BEAMS_PER_COLUMN = 32  # beams per column of a Velodyne


def shared_out(scenario: Scenario, workers: int) -> list[tuple[str, ...]]:
    """The sensors of each worker: costliest first, each to the worker with the least load."""
    sensors: dict[str, LidarScenario | CameraScenario] = {**scenario.lidars, **scenario.cameras}
    costs = {name: sensor.rate_hz * _cost_us(sensor) for name, sensor in sensors.items()}
    shares: list[list[str]] = [[] for _ in range(max(min(workers, len(costs)), 1))]
    for name in sorted(costs, key=lambda name: -costs[name]):
        min(shares, key=lambda share: sum(costs[other] for other in share)).append(name)
    return [tuple(share) for share in shares]


def _cost_us(sensor: LidarScenario | CameraScenario) -> float:
    """Rough cost of one measurement."""
    if isinstance(sensor, CameraScenario):
        per_pixel = MOVING_PIXEL_COST_US if sensor.mounted_on else PIXEL_COST_US
        return sensor.width_px * sensor.height_px * per_pixel
    beams: float = len(sensor.linear_elevations_deg) * sensor.columns
    if sensor.model != "linear":
        beams = BEAMS_PER_COLUMN / MODELS[sensor.model].column_us * 1e6 / sensor.rate_hz
    return beams / sensor.firing_stride * BEAM_COST_US


@contextmanager
def simulating(
    scenario: Scenario, *, ros_version: RosVersion, workers: int | None = None, driven: Collection[str] = ()
) -> Iterator["Simulation"]:
    """A running simulation on `workers` processes, this one among them; None for one per core.

    Workers start first, so that all processes load their libraries in parallel. The vehicles in `driven` wait at their
    start for `Simulation.command`.
    """
    mine, *others = shared_out(scenario, os.cpu_count() or 1 if workers is None else workers)
    with ExitStack() as stack:
        tasks = [SensingTask(scenario, tuple(driven), ros_version, names) for names in others]
        processes = [stack.enter_context(closing(SensingProcess(task))) for task in tasks]
        from lidcam.bags.simulator.recorder.simulation import Simulation  # Open3D takes a second or two

        yield Simulation(SensingTask(scenario, tuple(driven), ros_version, mine), processes)
