"""The work of one simulation process."""

from typing import NamedTuple

from bags.simulator.scenario.scenario import Scenario
from pipeline.core.ros.typestores import RosVersion

__all__ = ["SensingTask"]


class SensingTask(NamedTuple):
    """The work of one simulation process.

    Attributes:
        scenario: The scenario.
        driven: Vehicles that wait at their start for commands.
        ros_version: ROS version of the messages.
        names: Names of the sensors to simulate.
    """

    scenario: Scenario
    driven: tuple[str, ...]
    ros_version: RosVersion
    names: tuple[str, ...]
