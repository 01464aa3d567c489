"""Data sent to and from a simulation process: its task, and measurements with their messages."""

from typing import NamedTuple

from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.ros.typestores import RosVersion

STEP_NS = 100_000_000
"""Default step of a simulation."""


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


class Recorded(NamedTuple):
    """One serialised message; messages are ordered by the first three fields.

    Attributes:
        log_ns: True time since the scenario began.
        topic: Topic name.
        stamp_ns: Header stamp; `log_ns` for messages without a header.
        msgtype: Type name, for instance `sensor_msgs/msg/PointCloud2`.
        data: The message in the encoding of the recording.
        latched: Whether late subscribers receive it too.
    """

    log_ns: int
    topic: str
    stamp_ns: int
    msgtype: str
    data: bytes
    latched: bool = False


class Measured(NamedTuple):
    """One measurement of a sensor.

    Attributes:
        sensor: Full name of the sensor, as in `Scenario.sensors`.
        from_ns: Start of the time that it represents.
        until_ns: End of that time.
        hits: (M,) int64 points or pixels on each mover.
        hit_offsets_ns: (M,) int64 sum of the times of a mover's points after `from_ns`; 0 for pixels.
        recorded: Its messages; empty if it was lost.
    """

    sensor: str
    from_ns: int
    until_ns: int
    hits: I64
    hit_offsets_ns: I64
    recorded: tuple[Recorded, ...]
