"""Views: the pose of each camera at the time of its image, in the site frame at the frame's time.

The messages of one frame are measured at different times, between which a rig on a vehicle moves: at 20 m/s and 50 ms
by a metre. The clouds are moved to the frame's time (`lidcam.pipeline.filters.motion`); boxes from them fit into an
image only with the camera's pose at the time of the image.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.combine import MotionConfig

STILL = 1e-9
"""Maximum difference from identity, in metres and radians, of a motion that is rounding."""


class Views:
    """The cameras of the rig, each moved by the rig's own motion to the time of its message.

    For points p of the site frame at the frame's time t, and a message of time m, the camera's extrinsics become
    `T_camera_site @ inv(T_fixed_site(m)) @ T_fixed_site(t)`: static objects are projected to their place in the image,
    moving ones are off by their motion in that time.

    The time of a camera is that of its recorded 2D boxes, else of its image, with `time_offset_ns` removed. Without a
    message, without known motion (`PoseSamples.covers`), with motion switched off, or on a standing rig, a camera stays
    as it is.
    """

    def __init__(self, rig: Rig, config: MotionConfig) -> None:
        self._site_frame = rig.site_frame
        self._standing = {camera.name: camera for camera in rig.cameras}
        self._config = config

    def __call__(self, bundle: SensorBundle) -> Mapping[str, CameraSensor]:
        """By name, for all cameras of the rig in order; raises FrameError if the motion is another frame's."""
        motion = bundle.motion_of(self._site_frame) if self._config.enabled else None
        if motion is None:
            return self._standing
        times_ns = {name: _time_ns(camera, bundle) for name, camera in self._standing.items()}
        moved = [
            name
            for name, time_ns in times_ns.items()
            if time_ns != bundle.stamp_ns and motion.covers(time_ns, bundle.stamp_ns)
        ]
        if not moved:
            return self._standing
        poses = motion.at(*(times_ns[name] for name in moved), bundle.stamp_ns)
        T_then_now = np.linalg.inv(poses[:-1]) @ poses[-1]
        views = dict(self._standing)
        for name, matrix in zip(moved, T_then_now, strict=True):
            if np.abs(matrix - np.eye(4)).max() > STILL:
                camera = self._standing[name]
                own_motion = Transform(self._site_frame, self._site_frame, matrix)
                views[name] = replace(camera, T_camera_site=camera.T_camera_site @ own_motion)
        return views


def _time_ns(camera: CameraSensor, bundle: SensorBundle) -> int:
    """The time of the camera's boxes or image; the frame's time without either."""
    found = (bundle.messages.get(topic) for topic in (camera.boxes_topic, camera.topic) if topic)
    return next((message.stamp_ns for message in found if message is not None), bundle.stamp_ns)
