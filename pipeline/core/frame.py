"""One moment on its way through the stages: the messages that go in, the result that comes out."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pipeline.core.arrays import I32, check_array
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes2D, Boxes3D, Matches
from pipeline.core.geometry.pose_samples import PoseSamples
from pipeline.core.messages import Drop, RawMessage

__all__ = ["FrameResult", "SensorBundle"]


@dataclass(frozen=True, slots=True, eq=False)
class SensorBundle:
    """Messages that belong to one moment, one per synchronised topic, still undecoded.

    Attributes:
        index: Running number of the frame, from 0.
        stamp_ns: Stamp of the reference topic's message: the frame's time.
        log_time_ns: Log time of that message.
        messages: By topic.
        motion: Poses of the site frame around `stamp_ns`, if the recording has odometry of it.
        left_out: How many messages were left out of every frame since the bundle before, by (topic, reason).
    """

    index: int
    stamp_ns: int
    log_time_ns: int
    messages: Mapping[str, RawMessage]
    motion: PoseSamples | None = None
    left_out: Mapping[tuple[str, str], int] = field(default_factory=dict)

    @property
    def skew_ns(self) -> int:
        """Largest minus smallest stamp of the set."""
        stamps = [message.stamp_ns for message in self.messages.values()]
        return max(stamps) - min(stamps)


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """Everything a writer needs of one frame.

    Attributes:
        bundle: The messages that the frame was made of; images are copied from here.
        combined: The combined cloud.
        lidar_boxes: What the lidars alone saw, in the site frame.
        camera_boxes: What each camera alone saw, by camera name.
        matches: By camera name, for every camera of the rig; for the rows of `lidar_boxes`.
        objects: The fused objects, in the site frame.
        matched: (N,) int32 for the rows of `objects`: number of cameras that confirm it.
        drops: Messages of the bundle that could not be used.
        left_out: Recorded 2D boxes that could not be used, by reason.
    """

    bundle: SensorBundle
    combined: CombinedCloud
    lidar_boxes: Boxes3D
    camera_boxes: Mapping[str, Boxes2D]
    matches: Mapping[str, Matches]
    objects: Boxes3D
    matched: I32
    drops: tuple[Drop, ...] = ()
    left_out: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_array("matched", self.matched, (len(self.objects),), np.int32)
