"""Truth in the site frame: by fixed transforms, or by the recorded motion of the site frame."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from lidcam.pipeline.core.errors import FrameError, LidcamError
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.pipeline.evaluation.evaluation_frame import TruthBoxes3D
from lidcam.readers.messages.tf import RecordedTransforms, read_transforms, tf_topics
from lidcam.readers.recording import Recording
from lidcam.readers.streams.motion import MotionBuffer, MotionSource, find_motion_source, links_up


class SitePoses:
    """Poses of the site frame in the frames of the truth; the first recording that joins two frames is used."""

    def __init__(self, recordings: Sequence[Recording], rig: Rig, config: Config) -> None:
        self._recordings, self._rig, self._config = recordings, rig, config
        self._ways: dict[str, Transform | _Motion | str] = {}

    def T_site_frame(self, frame_id: str, stamp_ns: int) -> Transform | None:
        """The transform from a frame to the site frame at a time; None if the motion is not known at that time.

        Times rise, apart from steps back as of `TruthSource`.

        Raises:
            FrameError: nothing recorded joins the frames.
        """
        if frame_id not in self._ways:
            self._ways[frame_id] = self._way(frame_id)
        way = self._ways[frame_id]
        if isinstance(way, str):
            raise FrameError(way)
        return way if isinstance(way, Transform) else way.at(stamp_ns)

    def T_fixed_site(self, stamp_ns: int) -> Transform | None:
        """T_fixed_site at a time, in a frame that does not move; None if the motion of the site is not known then.

        A site whose motion nobody recorded stands still, as for `lidcam process`. Times rise, apart from steps back as
        of `TruthSource`.
        """
        if self._own_motion is None:
            return Transform.identity(self._rig.site_frame, self._rig.site_frame)
        T_site_fixed = self._own_motion.at(stamp_ns)
        return None if T_site_fixed is None else T_site_fixed.inverse()

    @cached_property
    def _own_motion(self) -> "_Motion | None":
        for recording in self._recordings:
            transforms = read_transforms(recording, limits=self._config.limits)
            if source := _find_source(recording, self._rig, transforms, self._config):
                fixed = source.fixed_frame_id
                return _Motion(recording, source, Transform.identity(fixed, fixed), self._config.limits)
        return None

    def _way(self, frame_id: str) -> "Transform | _Motion | str":
        site = self._rig.site_frame
        if frame_id in ("", site):
            return Transform.identity(site, frame_id or site)
        known: dict[str, None] = {}
        for recording in self._recordings:
            transforms = read_transforms(recording, limits=self._config.limits)
            known |= dict.fromkeys((*sorted(transforms.fixed.frames), *sorted(transforms.moving)))
            if transforms.are_joined(site, frame_id):
                return transforms.lookup(site, frame_id)
            if motion := _motion_in(frame_id, recording, self._rig, transforms, self._config):
                return motion
        return (
            f"expected transforms or odometry that join the truth's frame {frame_id!r} with the site frame {site!r}, "
            f"found {'those of ' + ', '.join(known) if known else 'none'}; give the recording that has them (--truth)"
        )


def boxes_in_site(boxes: TruthBoxes3D, T_site_frame: Transform) -> TruthBoxes3D:
    """Objects brought to the site frame, headings as seen from above."""
    along = np.stack([np.cos(boxes.yaws), np.sin(boxes.yaws), np.zeros(len(boxes))], -1) @ T_site_frame.matrix[:3, :3].T
    return replace(
        boxes,
        frame_id=T_site_frame.dst,
        centers=T_site_frame.apply(boxes.centers),
        yaws=wrap_angle(np.arctan2(along[:, 1], along[:, 0])),
    )


def _motion_in(
    frame_id: str, recording: Recording, rig: Rig, transforms: RecordedTransforms, config: Config
) -> "_Motion | None":
    """The motion of the site frame in a frame: over tf, else by odometry; None if neither is recorded."""
    way = links_up(rig.site_frame, transforms, is_end=lambda frame: transforms.are_joined(frame_id, frame))
    if way is None:
        return None
    links, frame = way[0], way[1][-1]
    if transforms.are_joined(frame_id, frame):
        source = MotionSource(tuple(tf_topics(recording)[1]), rig.site_frame, frame, tuple(links))
        return _Motion(recording, source, transforms.lookup(frame_id, frame), config.limits)
    found = _find_source(recording, rig, transforms, config)
    if found is None or not transforms.are_joined(frame_id, found.fixed_frame_id):
        return None
    return _Motion(recording, found, transforms.lookup(frame_id, found.fixed_frame_id), config.limits)


def _find_source(recording: Recording, rig: Rig, transforms: RecordedTransforms, config: Config) -> MotionSource | None:
    try:
        return find_motion_source(recording, rig, transforms, config)
    except LidcamError:  # odometry that is configured and was not recorded here
        return None


class _Motion:
    """The motion of the site frame in one frame, read as it is needed; T_frame_fixed leads to it from the source's."""

    def __init__(
        self, recording: Recording, source: MotionSource, T_frame_fixed: Transform, limits: RecordingLimits
    ) -> None:
        self._buffer = MotionBuffer(source, limits=limits)
        self._messages = recording.messages(source.topics)
        self._source, self._T_frame_fixed = source, T_frame_fixed

    def at(self, stamp_ns: int) -> Transform | None:
        """T_site_frame at a time; None if it is not known."""
        while (newest_ns := self._buffer.newest_ns) is None or newest_ns <= stamp_ns:  # two poses make a motion
            message = next(self._messages, None)
            if message is None:
                break
            deque(self._buffer.tap([message]), maxlen=0)
        motion = self._buffer.window(stamp_ns)
        if not motion.covers(stamp_ns):
            return None
        T_fixed_site = Transform(self._source.fixed_frame_id, self._source.frame_id, motion.at(stamp_ns)[0])
        return (self._T_frame_fixed @ T_fixed_site).inverse()
