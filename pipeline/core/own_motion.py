"""How far the site frame itself has moved since an earlier moment."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.frame import SensorBundle
from pipeline.core.geometry.poses import interpolate_poses
from pipeline.core.settings.combine import MotionConfig

__all__ = ["own_motion"]


def own_motion(bundle: SensorBundle, since_ns: int, site_frame: str, config: MotionConfig) -> F64 | None:
    """(4, 4) from the site frame at `since_ns` to that at the time of a bundle; None where it moves and how is unknown.

    Without odometry, or where motion is switched off, the site frame stands still.

    Raises:
        FrameError: the motion is that of a frame other than the site frame.
    """
    motion = bundle.motion_of(site_frame) if config.enabled else None
    if motion is None:
        return np.eye(4)
    earlier_ns, later_ns = sorted((since_ns, bundle.stamp_ns))
    if not motion.covers(
        earlier_ns, later_ns, max_extrapolation_s=config.max_extrapolation_s, max_gap_s=config.max_gap_s
    ):
        return None
    wanted_ns = np.array([since_ns, bundle.stamp_ns], np.int64)
    then, now = interpolate_poses(motion.stamps_ns, motion.T_fixed_moving, wanted_ns)
    return np.asarray(np.linalg.inv(now) @ then)
