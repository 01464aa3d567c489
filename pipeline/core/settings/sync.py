"""Settings of synchronisation."""

from typing import Literal

from pipeline.core.settings.model import Count, NotNegative, Positive, SettingsModel, Topic

__all__ = ["SyncConfig"]


class SyncConfig(SettingsModel):
    """Finding the messages of one moment.

    Attributes:
        policy: `approximate_time` (message_filters in C++), `approximate_time_python` (message_filters in Python, as in
            the predecessor system) or `nearest` (nearest to each message of the reference topic).
        reference: Topic whose stamps the frames take; if empty, the first lidar's.
        queue_size: Messages kept per topic.
        slop_s: Under `approximate_time_python`, the stamps of a frame spread by less than this; under `nearest`, they
            are at most this far from the reference. `approximate_time` does not use it.
        max_interval_s: Largest spread of the stamps of a frame under `approximate_time`; null for no limit, as in ROS.
        age_penalty: Under `approximate_time`, a later set must be better by this share of its delay.
    """

    policy: Literal["approximate_time", "approximate_time_python", "nearest"] = "approximate_time"
    reference: Topic = ""
    queue_size: Count = 10
    slop_s: NotNegative = 0.1
    max_interval_s: Positive | None = 0.1
    age_penalty: NotNegative = 0.1
