"""Requests to the processes of a simulation, and their answers."""

from typing import NamedTuple

from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.ros.typestores import RosVersion

STEP_NS = 100_000_000  # default step of a simulation


class SensingTask(NamedTuple):
    """The work of one simulation process."""

    scenario: Scenario
    driven: tuple[str, ...]  # vehicles that wait at their start for commands
    ros_version: RosVersion
    names: tuple[str, ...]  # names of the sensors to simulate


class Recorded(NamedTuple):
    """One serialised message; messages are ordered by the first three fields."""

    log_ns: int  # true time since the scenario began
    topic: str
    stamp_ns: int  # header stamp; `log_ns` for messages without a header
    msgtype: str  # for instance `sensor_msgs/msg/PointCloud2`
    data: bytes  # the message in the encoding of the recording
    latched: bool = False  # late subscribers receive it too


class Measured(NamedTuple):
    """One measurement of a sensor, and the time that it represents."""

    sensor: str  # full name of the sensor, as in `Scenario.sensors`
    from_ns: int
    until_ns: int
    hits: I64  # (M,) points or pixels on each mover
    hit_offsets_ns: I64  # (M,) sum of the times of a mover's points after `from_ns`; 0 for pixels
    recorded: tuple[Recorded, ...]  # empty if the measurement was lost
