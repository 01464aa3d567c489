"""Views: where each camera stood when it took its image, as seen from the site frame at the frame's time.

The messages of one frame are measured at different times. In the time between them a rig on a vehicle moves: at 20 m/s
and 50 ms by a metre. The clouds are moved to the frame's time (`lidcam.pipeline.filters.motion`); boxes from them fit
into an image only if the camera is placed where it was at the time of the image.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.poses import interpolate_poses
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.combine import MotionConfig

STILL = 1e-9
"""Motion whose matrix differs from identity by less, in metres and radians, is rounding."""


class Views:
    """The cameras of the rig, each moved by the rig's own motion to the time of its message.

    For points p of the site frame at the frame's time t, and a message of time m, the camera's extrinsics become
    `T_camera_site @ inv(T_fixed_site(m)) @ T_fixed_site(t)`: what stands still in the fixed frame is projected to where
    the image shows it. What moves by itself is off by its own motion in that time.

    The time of a camera is that of its 2D boxes where they were recorded, else of its image; both by the clock of the
    recording, with `time_offset_ns` taken off. A camera stays as it is where it has no message, where the motion is not
    known (`PoseSamples.covers`) or switched off, and where the rig stands still.
    """

    def __init__(self, rig: Rig, config: MotionConfig) -> None:
        self._site_frame = rig.site_frame
        self._standing = {camera.name: camera for camera in rig.cameras}
        self._config = config

    def __call__(self, bundle: SensorBundle) -> Mapping[str, CameraSensor]:
        """By camera name, for every camera of the rig, in its order.

        Raises:
            FrameError: the motion is that of a frame other than the site frame.
        """
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
        wanted_ns = np.array([*(times_ns[name] for name in moved), bundle.stamp_ns], np.int64)
        poses = interpolate_poses(motion.stamps_ns, motion.T_fixed_moving, wanted_ns)
        T_then_now = np.linalg.inv(poses[:-1]) @ poses[-1]
        views = dict(self._standing)
        for name, matrix in zip(moved, T_then_now, strict=True):
            if np.abs(matrix - np.eye(4)).max() > STILL:
                camera = self._standing[name]
                own_motion = Transform(self._site_frame, self._site_frame, matrix)
                views[name] = replace(camera, T_camera_site=camera.T_camera_site @ own_motion)
        return views


def _time_ns(camera: CameraSensor, bundle: SensorBundle) -> int:
    """When the camera's boxes or image were measured; the frame's time if it has neither."""
    found = (bundle.messages.get(topic) for topic in (camera.boxes_topic, camera.topic) if topic)
    return next((message.stamp_ns for message in found if message is not None), bundle.stamp_ns)
