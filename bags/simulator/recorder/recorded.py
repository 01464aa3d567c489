"""What comes out of a simulation: messages as they are recorded, and the measurements that they belong to."""

from typing import NamedTuple

from pipeline.core.arrays import I64

__all__ = ["STEP_NS", "Measured", "Recorded"]

STEP_NS = 100_000_000
"""How far a simulation goes at a time, where nobody asks for another step."""


class Recorded(NamedTuple):
    """One serialised message as it is recorded; in the order of the first three fields.

    Attributes:
        log_ns: True time since the scenario began.
        topic: Where.
        stamp_ns: Of its header, or as `log_ns` where it has none.
        msgtype: As `sensor_msgs/msg/PointCloud2`.
        data: The message in the encoding of the recording.
        latched: Whether late subscribers get it, too.
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
        by_lidar: Else by a camera.
        from_ns: From then on it stands for what is there.
        until_ns: Until then.
        hits: (M,) int64 points or pixels on each mover.
        recorded: Its messages; none if it was lost.
    """

    by_lidar: bool
    from_ns: int
    until_ns: int
    hits: I64
    recorded: tuple[Recorded, ...]
