"""Settings of the synchronisation."""

from typing import Literal

from pipeline.core.settings.model import Count, NotNegative, Positive, SettingsModel

__all__ = ["SyncConfig"]


class SyncConfig(SettingsModel):
    """How messages of one moment are found.

    Attributes:
        policy: `approximate_time` (message_filters in C++), `approximate_time_python` (the original's) or `nearest`.
        reference: Topic whose stamp a frame takes; empty: the first lidar's.
        queue_size: Messages kept per topic.
        slop_s: Largest spread of the stamps of a set (python policy: exclusive; nearest: distance to the reference).
        max_interval_s: Largest spread under `approximate_time`; None for no bound, as in ROS.
        age_penalty: How much better a newer set must be under `approximate_time`.
    """

    policy: Literal["approximate_time", "approximate_time_python", "nearest"] = "approximate_time"
    reference: str = ""
    queue_size: Count = 10
    slop_s: NotNegative = 0.1
    max_interval_s: Positive | None = 0.1
    age_penalty: NotNegative = 0.1
