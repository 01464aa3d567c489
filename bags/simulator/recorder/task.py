"""What a process of a simulation is told to do."""

from typing import NamedTuple

from bags.simulator.scenario.scenario import Scenario
from pipeline.core.ros.typestores import RosVersion

__all__ = ["SensingTask"]


class SensingTask(NamedTuple):
    """What a process of a simulation has to do.

    Attributes:
        scenario: What is simulated.
        driven: Vehicles that stand at their start until they are driven.
        ros_version: Whose messages.
        names: Its sensors.
    """

    scenario: Scenario
    driven: tuple[str, ...]
    ros_version: RosVersion
    names: tuple[str, ...]
