"""Poses of a moving frame: as recorded, between what was recorded, and as the clouds say."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, CheckedTable, check_array
from lidcam.pipeline.core.geometry.rotations import pose_matrix, rotation_vectors, turned

MAX_EXTRAPOLATION_NS = 200_000_000
"""Longest time before the first or after the last known pose in which the motion counts as known."""

MAX_GAP_NS = 1_500_000_000
"""Longest time between two poses over which the motion counts as known: poses at 1 Hz are not exactly 1 s apart."""


def interpolate_poses(stamps_ns: I64, poses: F64, wanted_ns: I64) -> F64:
    """(W, 4, 4) poses at wanted times (W,): positions linear, rotations by slerp, extrapolated at constant velocity.

    Known are poses (S, 4, 4) at strictly increasing stamps (S,), S >= 2.
    """
    # Times relative to the first stamp: float64 seconds of the Unix epoch would only resolve 240 ns.
    start = int(stamps_ns[0])
    known = (stamps_ns - start).astype(np.float64)
    wanted = (wanted_ns - start).astype(np.float64)
    row = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, len(known) - 2)
    share = (wanted - known[row]) / (known[row + 1] - known[row])
    rotations = poses[:, :3, :3]
    used, which = np.unique(row, return_inverse=True)
    steps = rotation_vectors(rotations[used].swapaxes(1, 2) @ rotations[used + 1])[which]
    places = poses[row, :3, 3] * (1 - share[:, None]) + poses[row + 1, :3, 3] * share[:, None]
    return pose_matrix(rotations[row] @ turned(steps * share[:, None]), places)


@dataclass(frozen=True, slots=True, eq=False)
class PoseSamples(CheckedTable):
    """Poses of a moving frame around one moment, for motion compensation."""

    ROWS: ClassVar = {"T_fixed_moving": (4, 4)}

    frame_id: str  # The frame that moves (the site or vehicle frame)
    fixed_frame_id: str  # The frame in which it moves (`odom`, `map`)
    stamps_ns: I64  # (S,) int64, strictly increasing
    T_fixed_moving: F64  # (S, 4, 4) float64, pose of the moving frame at each stamp

    def covers(self, *times_ns: int) -> bool:
        """Whether the motion is known from the earliest to the latest of these times.

        The span may reach `MAX_EXTRAPOLATION_NS` beyond the first and the last pose, and the poses around and within it
        are at most `MAX_GAP_NS` apart. A single pose gives no motion.
        """
        if len(self) < 2:
            return False
        earliest_ns, latest_ns = min(times_ns), max(times_ns)
        first = max(int(np.searchsorted(self.stamps_ns, earliest_ns, side="right")) - 1, 0)
        last = int(np.searchsorted(self.stamps_ns, latest_ns, side="left"))
        around_ns = self.stamps_ns[first : last + 1]
        starts_near = around_ns[0] - MAX_EXTRAPOLATION_NS <= earliest_ns
        ends_near = latest_ns <= around_ns[-1] + MAX_EXTRAPOLATION_NS
        return bool(starts_near and ends_near and (np.diff(around_ns) <= MAX_GAP_NS).all())

    def at(self, *times_ns: int) -> F64:
        """(T, 4, 4) T_fixed_moving at some times; see `interpolate_poses`."""
        return interpolate_poses(self.stamps_ns, self.T_fixed_moving, np.array(times_ns, np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class OdometryPose:
    """Pose of the site frame at a frame's stamp, from the clouds, or recorded and corrected by them."""

    # (4, 4) float64, in the frame that the site frame was in the first cloud, or in the recorded fixed frame at the
    # start; metres
    T_fixed_site: F64
    # Whether the cloud could not be registered, so that this is the recorded or the last motion carried on
    is_predicted: bool

    def __post_init__(self) -> None:
        check_array("T_fixed_site", self.T_fixed_site, (4, 4), np.float64)
