"""The motion of the rig from its clouds, registered by small_gicp to key frames.

Generalized ICP (Segal et al., "Generalized-ICP", RSS 2009). Each cloud is registered to the key frame before the last,
some voxels away: the pattern of the beams is fixed in the site frame, and pulls the registration of clouds that are
nearer to each other than its gaps towards no motion.

Recorded motion is corrected once the rig is as far away from a key frame: each step is the recorded one plus an error
per metre, filtered from the registrations of the last MEMORY_FRAMES frames (growing-memory g-h filter; Brookner,
"Tracking and Kalman Filtering Made Easy", 1998, ch. 1 and 5). That removes drift without the noise of registration: on
KITTI drive 0009 the recorded course is 1.4 degrees off the heading, by which static objects at the roadside would drift
by 0.2 m/s. Where the clouds differ from the recorded step by more than odometry errors, as in dense traffic, or are
featureless, as in a tunnel, the step is kept.

Most rigs without recorded motion stand still. The clouds of the first second decide: a rig moves if the registered pose
explains a cloud better than standing still. Afterwards a thin sample of points is compared once a second.
"""

from enum import Enum, auto
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.geometry.pose_samples import OdometryPose
from lidcam.pipeline.core.geometry.rotations import pose_matrix, rotation_vectors, turned

if TYPE_CHECKING:
    from small_gicp import KdTree, PointCloud, RegistrationResult

UNITS_PER_EXTENT = 20
"""Units of distance per extent of a cloud (median distance of its points from their middle): 0.3 m on roads, 8 cm in
models. Distances below are in units."""

VOXEL = 1.5
"""Size of the voxels in which points are thinned; one unit takes twice the time for no more accuracy."""

MAX_POINTS = 60_000
"""Maximum number of points of a cloud, evenly thinned."""

PRECISION = 0.01
"""Step below which registration ends."""

MIN_POINTS = 200
"""Minimum number of thinned points of a cloud that is registered."""

NEAR_REACH, FAR_REACH = 4, 16
"""Maximum distance of corresponding points, with the motion roughly known and unknown."""

KEY_DISTANCE = 4
"""Distance between key frames."""

MIN_MOTION = 1.0
"""Minimum displacement of a moving rig."""

MIN_MISFIT_RATIO = 1.1
"""Minimum ratio of the misfit of standing still to that of the registered pose of a moving rig."""

MIN_MOVING_FRAMES = 2
"""Minimum number of consecutive frames in which a rig moves."""

MIN_INLIERS = 0.3
"""Minimum share of the points with a counterpart in a sound registration."""

MIN_SHAPE = 0.008
"""Minimum ratio of the information of the least to the most constrained direction: bare ground constrains none."""

MAX_STANDING_MISFIT_RATIO, MAX_STANDING_MISFIT = 1.5, 0.02
"""Maximum misfit of a standing rig: this multiple of the first one, and this much more."""

SAMPLE_POINTS = 3000
"""Number of points of a cloud that are compared while the rig stands."""

MAX_STEP_ERROR, MAX_STEP_ERROR_SHARE = 1.0, 0.1
"""Maximum error of a recorded step: a distance, and a share of the step in addition."""

MAX_ACCELERATION_M_S2 = 15.0
"""Maximum acceleration of a rig; a recorded step beyond it is a jump or noise, and the clouds decide."""

MIN_STEP = 0.1
"""Minimum length of a step from which the error per metre is estimated."""

MEMORY_FRAMES = 20
"""Number of frames from which the error of recorded steps is estimated; missing ones count, too: an error is not the
same for long."""

CHECK_NS = 1_000_000_000
"""Time after which a rig is known to stand, and period in which that is checked again, nanoseconds."""

MAX_GAP_NS = 2_000_000_000
"""Maximum gap between frames over which the velocity is kept, nanoseconds."""


class _State(Enum):
    UNKNOWN = auto()
    STANDS = auto()
    MOVES = auto()


class _Scan(NamedTuple):
    """A thinned cloud with normals and covariances, and its pose."""

    T_fixed_site: F64
    points: "PointCloud"
    tree: "KdTree"


class FindOdometry:
    """Poses of the site frame from its clouds. Remembers, so frames must come in order.

    It runs on one thread, so that the result is the same on any machine of a kind.
    """

    def __init__(self) -> None:
        self._state, self._since_ns, self._times = _State.UNKNOWN, 0, 0
        self._key: _Scan | None = None
        self._next: _Scan | None = None
        self._extent_m = self._unit_m = 0.0
        self._pose, self._step = np.eye(4), np.eye(4)
        self._stamp_ns, self._step_ns = 0, 0  # of 0: the velocity is not known
        self._usual: float | None = None
        self._recorded: F64 | None = None
        self._recorded_m_s: F64 | None = None  # Velocity of the last recorded step, along the axes of the site
        self._error, self._steps = np.zeros(6), 1  # of recorded steps, a twist per metre

    def __call__(self, combined: CombinedCloud, stamp_ns: int, T_fixed_site: F64 | None = None) -> OdometryPose | None:
        """The pose at a frame; None as long as the rig has not moved, or has had no points.

        Args:
            combined: The points of the frame, with those of the ground.
            stamp_ns: Its time.
            T_fixed_site: (4, 4) recorded pose; the fixed frame is that of the first one.
        """
        before, self._recorded = self._recorded, T_fixed_site
        if self._state is _State.STANDS and not self._is_disturbed(combined, stamp_ns):
            return None
        xyz = np.concatenate([combined.cloud.xyz, combined.ground_cloud.xyz])
        if self._key is None:
            self._begin(xyz, stamp_ns, T_fixed_site)
            return None
        step = None if T_fixed_site is None or before is None else np.linalg.inv(before) @ T_fixed_site
        if step is None or self._is_jump(step, stamp_ns):
            pose = self._guess(stamp_ns)
            scan, is_found = self._registered(xyz, pose, is_near=self._step_ns > 0)
            pose = scan.T_fixed_site if scan is not None and is_found else pose
        else:
            pose, scan, is_found = self._corrected(xyz, step, stamp_ns)
        if self._state is _State.UNKNOWN and not self._has_moved(scan if is_found else None, stamp_ns):
            return None
        self._follow(pose, scan, stamp_ns, is_found=is_found, is_known=is_found or step is not None)
        return OdometryPose(pose.copy(), not is_found)

    def _is_jump(self, step: F64, stamp_ns: int) -> bool:
        """Whether a recorded step fits neither the motion so far nor the recorded step before."""
        seconds = (stamp_ns - self._stamp_ns) * 1e-9
        if not 0 < stamp_ns - self._stamp_ns <= MAX_GAP_NS:
            self._recorded_m_s = None
            return False
        before, self._recorded_m_s = self._recorded_m_s, step[:3, 3] / seconds
        if before is None or not self._step_ns:
            return False
        known = before, self._step[:3, 3] / (self._step_ns * 1e-9)
        return all(np.linalg.norm(self._recorded_m_s - one) > MAX_ACCELERATION_M_S2 * seconds for one in known)

    def _corrected(self, xyz: Any, step: F64, stamp_ns: int) -> tuple[F64, _Scan | None, bool]:
        """The filtered pose after a recorded step, and the result of `_registered` for it."""
        step_m = float(np.linalg.norm(step[:3, 3]))
        pose = self._pose @ step @ _motion(self._error * step_m)
        scan, is_found = self._registered(xyz, pose, is_near=True)
        if scan is None:
            return pose, None, False
        error = np.linalg.inv(pose) @ scan.T_fixed_site
        max_error_m = MAX_STEP_ERROR * self._unit_m + MAX_STEP_ERROR_SHARE * self._displacement_m(step)
        if not is_found or self._displacement_m(error) > max_error_m:
            return pose, scan._replace(T_fixed_site=pose), False
        missed = max(round((stamp_ns - self._stamp_ns) / self._step_ns) - 1, 0) if self._step_ns else 0
        self._steps = max(min(self._steps + 1, MEMORY_FRAMES) - missed, 2)
        assert self._key is not None
        if self._displacement_m(np.linalg.inv(self._key.T_fixed_site) @ pose) < KEY_DISTANCE * self._unit_m:
            return pose, scan._replace(T_fixed_site=pose), True
        k, twist = self._steps, _twist(error)
        if step_m > MIN_STEP * self._unit_m:
            self._error = self._error + twist * (6 / (k * (k + 1) * step_m))
        return pose @ _motion(twist * (2 * (2 * k - 1) / (k * (k + 1)))), scan, True

    def _begin(self, xyz: Any, stamp_ns: int, recorded: F64 | None) -> None:
        """Make the first cloud with points the fixed frame."""
        if len(xyz) < MIN_POINTS:
            return
        xy = xyz[:, :2].astype(np.float64)
        self._extent_m = float(np.median(np.linalg.norm(xy - np.median(xy, axis=0), axis=1)))
        self._unit_m = self._extent_m / UNITS_PER_EXTENT
        if recorded is not None:
            self._pose, self._state = recorded, _State.MOVES
        scan = self._scan(xyz, self._pose) if self._unit_m > 0 else None
        self._key = self._next = scan
        self._since_ns = self._stamp_ns = stamp_ns

    def _scan(self, xyz: Any, T_fixed_site: F64) -> _Scan | None:
        from small_gicp import preprocess_points

        thinned = xyz[:: len(xyz) // MAX_POINTS + 1].astype(np.float64)
        points, tree = preprocess_points(thinned, VOXEL * self._unit_m, num_neighbors=10, num_threads=1)
        return _Scan(T_fixed_site, points, tree) if points.size() >= MIN_POINTS else None

    def _guess(self, stamp_ns: int) -> F64:
        """The pose at constant velocity; the last one if the velocity is unknown."""
        gap_ns = stamp_ns - self._stamp_ns
        if not 0 < gap_ns <= MAX_GAP_NS:
            self._step_ns = 0
        if not self._step_ns:
            return self._pose
        return np.asarray(self._pose @ _motion(_twist(self._step) * (gap_ns / self._step_ns)))

    def _registered(self, xyz: Any, guess: F64, *, is_near: bool) -> tuple[_Scan | None, bool]:
        """The cloud at the pose that fits best, and whether that is reliable; None with too few points."""
        scan = self._scan(xyz, guess) if len(xyz) else None
        assert self._key is not None
        if scan is None:
            return None, False
        T_key_site = np.linalg.inv(self._key.T_fixed_site) @ guess
        if not is_near:
            T_key_site = self._aligned(scan, T_key_site, FAR_REACH).T_target_source
        found = self._aligned(scan, T_key_site, NEAR_REACH)
        # The information of rotation comes first, that of translation last.
        shape = np.linalg.eigvalsh(found.H[3:, 3:])
        is_found = found.num_inliers >= MIN_INLIERS * scan.points.size() and shape[0] >= MIN_SHAPE * shape[-1]
        return scan._replace(T_fixed_site=self._key.T_fixed_site @ found.T_target_source), bool(is_found)

    def _aligned(self, scan: _Scan, T_key_site: F64, reach: float) -> "RegistrationResult":
        from small_gicp import align

        assert self._key is not None
        return align(
            self._key.points,
            scan.points,
            self._key.tree,
            T_key_site,
            max_correspondence_distance=reach * self._unit_m,
            max_iterations=30,
            rotation_epsilon=1e-4,
            translation_epsilon=PRECISION * self._unit_m,
            num_threads=1,
        )

    def _has_moved(self, scan: _Scan | None, stamp_ns: int) -> bool:
        """Whether the rig has left its first place in this frame; single frames count, too."""
        has_moved = False
        if scan is not None and self._displacement_m(scan.T_fixed_site) > MIN_MOTION * self._unit_m:
            xyz = scan.points.points()[:, :3]
            has_moved = self.misfit(xyz, np.eye(4)) > MIN_MISFIT_RATIO * self.misfit(xyz, scan.T_fixed_site)
        self._times = self._times + 1 if has_moved else 0
        if has_moved:
            self._state = _State.MOVES if self._times >= MIN_MOVING_FRAMES else self._state
            return True
        self._pose, self._stamp_ns, self._step_ns = np.eye(4), stamp_ns, 0
        if stamp_ns - self._since_ns >= CHECK_NS:
            self._state, self._since_ns, self._usual = _State.STANDS, stamp_ns, None
            if scan is not None:
                self._key = self._next = scan._replace(T_fixed_site=np.eye(4))
        return False

    def _is_disturbed(self, combined: CombinedCloud, stamp_ns: int) -> bool:
        """Whether a standing rig has to be checked again: its cloud fits the key frame worse than before."""
        if 0 <= stamp_ns - self._since_ns < CHECK_NS:
            return False
        self._since_ns = stamp_ns
        sample = combined.cloud.xyz[:: len(combined.cloud) // SAMPLE_POINTS + 1].astype(np.float64)
        if not len(sample):
            return False
        misfit = self.misfit(sample, np.eye(4))
        if self._usual is None:
            self._usual = misfit
        if misfit <= MAX_STANDING_MISFIT_RATIO * self._usual + MAX_STANDING_MISFIT:
            return False
        self._state, self._times, self._stamp_ns, self._step_ns = _State.UNKNOWN, 0, stamp_ns, 0
        return True

    def misfit(self, xyz_site: F64, T_key_site: F64) -> float:
        """Mean squared distance of points (N, 3) from the surfaces of the key frame, in units; one unit at most."""
        assert self._key is not None
        xyz = xyz_site @ T_key_site[:3, :3].T + T_key_site[:3, 3]
        rows, squared = self._key.tree.batch_knn_search(xyz, 1)
        row, near = np.asarray(rows).ravel().astype(np.intp), np.asarray(squared).ravel() < (3 * self._unit_m) ** 2
        normals, points = self._key.points.normals()[row, :3], self._key.points.points()[row, :3]
        off = np.abs(np.einsum("ij,ij->i", xyz - points, normals)) / self._unit_m
        return float(np.mean(np.where(near, np.minimum(off, 1.0), 1.0) ** 2))

    def _displacement_m(self, T: F64) -> float:
        """Displacement of points at the edge of the scene by a motion."""
        angle = np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))
        return float(np.linalg.norm(T[:3, 3]) + angle * self._extent_m)

    def _follow(self, pose: F64, scan: _Scan | None, stamp_ns: int, *, is_found: bool, is_known: bool) -> None:
        """Update the velocity, and the key frames where one is due."""
        if is_known and 0 < stamp_ns - self._stamp_ns <= MAX_GAP_NS:
            self._step, self._step_ns = np.linalg.inv(self._pose) @ pose, stamp_ns - self._stamp_ns
        self._pose, self._stamp_ns = pose, stamp_ns
        if scan is None or self._state is not _State.MOVES:
            return
        assert self._next is not None
        if not is_found:  # the key frame shows other surroundings
            self._key = self._next = scan._replace(T_fixed_site=pose)
        elif self._displacement_m(np.linalg.inv(self._next.T_fixed_site) @ pose) >= KEY_DISTANCE * self._unit_m:
            self._key, self._next = self._next, scan


def _motion(twist: F64) -> F64:
    """(4, 4) matrix of a small motion (6,): translation, rotation vector."""
    return pose_matrix(turned(twist[3:]), twist[:3])


def _twist(motion: F64) -> F64:
    """(6,) inverse of `_motion`."""
    return np.concatenate([motion[:3, 3], *rotation_vectors(motion[None, :3, :3])])
