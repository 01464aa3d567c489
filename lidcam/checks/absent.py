"""Sensors that were recorded, and of which no frame has a message: their clocks are off, or no message is near."""

from collections.abc import Collection, Mapping, Sequence

from lidcam.checks.missing import MissingSensor
from lidcam.checks.warning import RunWarning
from pipeline.core.rig import BOXES_SUFFIX, Rig

__all__ = ["absence_warnings", "absent_sensors", "clocks_off"]

AHEAD_NS, BEHIND_NS = 1_000_000_000, 10_000_000_000
"""A clock that is this far ahead of, or behind, most others is off; messages may also be recorded some seconds late."""

MIN_FRAMES = 10
"""In fewer frames than these a sensor of a lower rate may be missing by chance."""


def clocks_off(delays_ns: Mapping[str, int], missing: Sequence[MissingSensor], rig: Rig) -> list[RunWarning]:
    """One for each clock that is off, if a sensor is in no frame at all.

    Args:
        delays_ns: Log time minus stamp of each topic's messages.
        missing: Sensors that are missing from frames.
        rig: Names the sensors, lidars first.
    """
    absent = _absent(missing)
    if not absent:
        return []
    names = rig.sensor_of_topic
    usual_ns = _usual_ns([delays_ns[topic] for topic in names if topic in delays_ns])
    off_ns = {
        names[topic]: usual_ns - delays_ns[topic]
        for topic in names
        if topic in delays_ns and not -AHEAD_NS <= delays_ns[topic] - usual_ns <= BEHIND_NS
    }
    return [_clock_warning(name, off_ns[name], len(absent)) for name in off_ns if not _is_with_camera(name, off_ns)]


def absent_sensors(missing: Sequence[MissingSensor]) -> list[MissingSensor]:
    """Sensors that sent messages, none of which is in a frame, though there were frames enough.

    A camera's boxes are named only without it.
    """
    absent = _absent(missing)
    names = {sensor.sensor for sensor in absent}
    return [sensor for sensor in absent if sensor.of_frames >= MIN_FRAMES and not _is_with_camera(sensor.sensor, names)]


def absence_warnings(missing: Sequence[MissingSensor]) -> list[RunWarning]:
    """One for each sensor that sent messages, none of which is in a frame."""
    return [
        RunWarning(
            sensor.sensor,
            f"none of the {sensor.of_frames} frames has a message of it, though it was recorded",
            "compare its stamps with those of the others, and see sync.slop_s and sync.max_interval_s",
        )
        for sensor in absent_sensors(missing)
    ]


def _absent(missing: Sequence[MissingSensor]) -> list[MissingSensor]:
    return [sensor for sensor in missing if sensor.alive_frames and sensor.frames == sensor.of_frames]


def _usual_ns(delays_ns: Sequence[int]) -> int:
    """The delay that most of the others are close to; of several, the first."""
    return max(delays_ns, key=lambda one: sum(abs(one - other) <= AHEAD_NS for other in delays_ns), default=0)


def _clock_warning(name: str, off_ns: int, absent: int) -> RunWarning:
    side = "after" if off_ns > 0 else "before"
    topics = "1 topic is" if absent == 1 else f"{absent} topics are"
    return RunWarning(
        name,
        f"its stamps lie {abs(off_ns) / 1e9:.1f} s {side} those of most sensors, so that {topics} in no frame",
        f"set its clock, or give it about time_offset_ms: {round(off_ns / 1e6)} in a rig file (--rig)",
    )


def _is_with_camera(name: str, names: Collection[str]) -> bool:
    """Whether a name is that of a camera's boxes, and the camera is named, too."""
    return name.endswith(BOXES_SUFFIX) and name.removesuffix(BOXES_SUFFIX) in names
