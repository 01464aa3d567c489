"""Starting a simulation: worker processes first, so that all processes load their libraries in parallel."""

import os
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from lidcam.bags.simulator.recorder.processes import SensingProcess, shared_out
from lidcam.bags.simulator.recorder.recorded import SensingTask
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.pipeline.core.ros.typestores import RosVersion

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.simulation import Simulation


@contextmanager
def simulating(
    scenario: Scenario,
    *,
    ros_version: RosVersion,
    workers: int | None = None,
    driven: Collection[str] = (),
) -> Iterator["Simulation"]:
    """A running simulation on so many worker processes, this one among them; None for one per core.

    The vehicles in `driven` wait at their start for `Simulation.command`.
    """
    mine, *others = shared_out(scenario, os.cpu_count() or 1 if workers is None else workers)
    with ExitStack() as stack:
        tasks = [SensingTask(scenario, tuple(driven), ros_version, names) for names in others]
        processes = [stack.enter_context(SensingProcess(task)) for task in tasks]
        from lidcam.bags.simulator.recorder.simulation import Simulation  # Open3D takes a second or two

        yield Simulation(SensingTask(scenario, tuple(driven), ros_version, mine), processes)
