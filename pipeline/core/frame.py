"""One frame on its way through the stages: the bundle of messages in, the result out."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Detections, Fused, Hypotheses, Matches
from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.pose_samples import OdometryPose, PoseSamples
from lidcam.pipeline.core.messages import Drop, RawMessage, VideoPart
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.combine import MotionConfig
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.core.true_boxes import TrueBoxes

T = TypeVar("T")


class Missing(StrEnum):
    """Why a frame has no message of a topic."""

    SILENT = "silent"
    NOT_NEAR = "no message within sync.slop_s of the frame"
    NO_IMAGE = "its message holds no image"


@dataclass(frozen=True, slots=True, eq=False)
class SensorBundle:
    """Messages of one moment, at most one per synchronised topic, undecoded.

    Attributes:
        index: Number of the frame, from 0.
        stamp_ns: Stamp of the reference message, the frame's time.
        log_time_ns: Log time of that message.
        messages: By topic.
        motion: Poses of the site frame around `stamp_ns`; None without odometry.
        dropped_before: Number of messages dropped since the previous bundle, by (topic, reason).
        missing: Why there is no message, by synchronised topic without one.
        copied: Recorded messages that an output takes over as they are, in the order in which they were recorded.
        truth: Recorded truth among them, to be drawn.
        video: By topic whose image was decoded from a video, the packets that a decoder needs for it after those of the
            bundles before. Without entry if the video's images are not in the order of its packets.
    """

    index: int
    stamp_ns: int
    log_time_ns: int
    messages: Mapping[str, RawMessage]
    motion: PoseSamples | None = None
    dropped_before: Mapping[tuple[str, str], int] = field(default_factory=dict)
    missing: Mapping[str, Missing] = field(default_factory=dict)
    copied: tuple[RawMessage, ...] = ()
    truth: tuple[TrueBoxes, ...] = ()
    video: Mapping[str, VideoPart] = field(default_factory=dict)

    __repr__ = brief

    @property
    def skew_ns(self) -> int:
        """Largest minus smallest stamp of the set; 0 of no messages."""
        stamps = [message.stamp_ns for message in self.messages.values()]
        return max(stamps, default=0) - min(stamps, default=0)

    def motion_of(self, site_frame: str) -> PoseSamples | None:
        """The motion of that frame; None where nothing is known of it. Raises FrameError if it is another frame's."""
        if self.motion is not None and self.motion.frame_id != site_frame:
            raise FrameError(f"motion: expected poses of the site frame {site_frame!r}, got {self.motion.frame_id!r}")
        return self.motion

    def pose_of(self, site_frame: str) -> F64 | None:
        """(4, 4) T_fixed_site at the stamp, as recorded, or None; raises FrameError if it is of another frame."""
        motion = self.motion_of(site_frame)
        return motion.at(self.stamp_ns)[0] if motion is not None and len(motion) > 1 else None


@dataclass(frozen=True, slots=True, eq=False)
class Decoded(Mapping[str, T]):
    """Decoded messages of one frame by sensor name, in rig order.

    A sensor whose message is missing or bad has no entry.
    """

    by_sensor: Mapping[str, T]  # The decoded values
    drops: tuple[Drop, ...] = ()  # The bad messages
    unused_boxes: Mapping[str, int] = field(default_factory=dict)  # Recorded boxes that could not be used, by reason

    __repr__ = brief

    def __getitem__(self, sensor: str) -> T:
        return self.by_sensor[sensor]

    def __iter__(self) -> Iterator[str]:
        return iter(self.by_sensor)

    def __len__(self) -> int:
        return len(self.by_sensor)


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """All results of one frame, for the writers.

    Attributes:
        bundle: The messages of the frame; images are copied from here.
        combined: The combined cloud.
        detections: The detections before fusion.
        views: By camera name, for every camera of the rig: the camera as it stood when its image was taken, in the site
            frame at the frame's time.
        hypotheses: The weighed hypotheses.
        beliefs: (N,) float64, existence probability of each of them.
        fused: The fused objects, in the site frame.
        drops: Messages of the bundle that could not be used.
        unused_boxes: Recorded 2D boxes that could not be used, by reason.
        unused_boxes3d: Recorded 3D boxes that could not be used, by reason.
        odometry: Pose of the site frame as the clouds say; None where the rig stands where it stood at first, and where
            this is not sought: with recorded motion, or without tracks.
    """

    bundle: SensorBundle
    combined: CombinedCloud
    detections: Detections
    views: Mapping[str, CameraSensor]
    hypotheses: Hypotheses
    beliefs: F64
    fused: Fused
    drops: tuple[Drop, ...] = ()
    unused_boxes: Mapping[str, int] = field(default_factory=dict)
    unused_boxes3d: Mapping[str, int] = field(default_factory=dict)
    odometry: OdometryPose | None = None

    __repr__ = brief

    @property
    def matches(self) -> Mapping[str, Matches]:
        """By camera name, for every camera of the rig; rows refer to `hypotheses.boxes`."""
        return self.hypotheses.matches


def own_motion(bundle: SensorBundle, since_ns: int, site_frame: str, config: MotionConfig) -> F64 | None:
    """(4, 4) from the site frame at `since_ns` to that at the time of a bundle; None where it moves and how is unknown.

    Without odometry, or where motion is switched off, the site frame stands still. Raises FrameError if the motion is
    that of a frame other than the site frame.
    """
    motion = bundle.motion_of(site_frame) if config.enabled else None
    if motion is None:
        return np.eye(4)
    if not motion.covers(since_ns, bundle.stamp_ns):
        return None
    then, now = motion.at(since_ns, bundle.stamp_ns)
    return np.asarray(np.linalg.inv(now) @ then)
