"""Settings of synchronisation."""

from typing import Literal

from lidcam.pipeline.core.settings.model import Count, NotNegative, Positive, SettingsModel


class SyncConfig(SettingsModel):
    """Finding the messages of one moment.

    Attributes:
        reference: Topic whose stamps the frames take, and which they need, while it is alive; if empty or silent, the
            first required one that is alive.
        queue_size: Messages kept per required topic, and frames that wait for the other topics; of those, twice as many
            messages are kept.
        slop_s: Messages of the topics that are not required are at most this far from the reference.
        max_interval_s: Largest spread of the required topics' stamps in a frame; null for no limit, as in ROS. `auto`:
            0.1, or a little more than half a period of a slower required topic, up to 0.3.
        required: Topics that a frame needs while they are alive: `lidars` (in a recording without any, those of the
            recorded 3D boxes that are used), or a list of topics. The others join a frame with the message nearest to
            its reference, if it is within `slop_s`. If none is alive, the next topic that is (a lidar, a camera, boxes)
            takes over. `all`: every frame has a message of each topic, as in ROS.
        silent_after_s: A topic without a message for this long, or for 2.5 of its periods if these are longer, is
            silent, and not waited for until its next message.
        every: Of this many frames the first is processed: 1 for all.
    """

    reference: str = ""
    queue_size: Count = 10
    slop_s: NotNegative = 0.1
    max_interval_s: Positive | Literal["auto"] | None = "auto"
    required: Literal["lidars", "all"] | tuple[str, ...] = "lidars"
    silent_after_s: Positive = 0.5
    every: Count = 1
