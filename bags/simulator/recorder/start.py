"""Starting a simulation, with its sensors shared out over processes."""

import os
from collections.abc import Collection, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING

from lidcam.bags.simulator.recorder.processes import SensingProcess
from lidcam.bags.simulator.recorder.recorded import SensingTask
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario, LidarScenario
from lidcam.pipeline.core.ros.typestores import RosVersion
from lidcam.readers.velodyne.models import MODELS

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.simulation import Simulation

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
    task = SensingTask(scenario, tuple(driven), ros_version, mine)
    with ExitStack() as stack:
        processes = [stack.enter_context(closing(SensingProcess(task._replace(names=names)))) for names in others]
        from lidcam.bags.simulator.recorder.simulation import Simulation  # Open3D takes a second or two

        yield Simulation(task, processes)
