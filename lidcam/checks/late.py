"""Sensors whose messages come too late for their frames."""

from collections.abc import Mapping

from lidcam.checks.warning import RunWarning
from pipeline.core.rig import Rig
from pipeline.stages.sync.policy import DropReason

__all__ = ["late_warnings"]

MIN_SHARE = 0.1
"""Of a sensor's messages: single ones are late where a sensor begins, or where the recorder was busy."""


def late_warnings(drops: Mapping[tuple[str, str], int], received: Mapping[str, int], rig: Rig) -> list[RunWarning]:
    """One for each sensor of which many messages are late.

    Args:
        drops: Number of dropped messages by topic and reason.
        received: Number of messages by topic.
        rig: Names the sensors.
    """
    names = rig.sensor_of_topic
    return [
        RunWarning(
            names[topic],
            f"{count} of {received[topic]} messages came after their frames were complete",
            "a larger sync.queue_size waits longer; if its clock is off, give its time_offset_ms in the rig file",
        )
        for (topic, reason), count in drops.items()
        if reason == DropReason.TOO_LATE and count >= MIN_SHARE * received[topic]
    ]
