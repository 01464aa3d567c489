"""Errors of one camera's pose and clock, by robust least squares over the pairs of a run.

An object that only the lidars placed is moved by its track to the time of the image and projected; the edges of its
2D box should be there. Unknown are a small rotation and translation of the camera, by how much its images were taken
later than their stamps say, and the habits of 2D boxes: by which share of its width and height a box is larger than
the outline of the object (left and right alike, top and bottom each). Time is told from yaw by how fast the objects go
through the image.

An edge is worth as much as it is known: by the pixels and the outline (`fuse.pixel_sigma_px`, `fuse.outline_sigma`),
and by the lidar's box (`box_prior`): the end of a car that no lidar saw is uncertain, and the one that they saw is not.
Pairs that fit badly weigh little (Huber, 1964). The pairs of one track err alike for seconds, so the covariance is that
of clusters, a track over `CLUSTER_S` each.
"""

from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.calibration.motions import cluster_covariance, motion, turned
from lidcam.pipeline.calibration.pairs import TrackedPairs
from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.projection import CameraArrays, project_edges, rounded_outline
from lidcam.pipeline.fusion.refining.box_prior import box_prior

MIN_PAIRS, MIN_TRACKS = 60, 2
"""A camera with fewer pairs, or pairs of fewer tracks, is not judged."""

CLUSTER_S = 3.0
"""The pairs of a track within so long err alike."""

HUBER = 1.5
"""Pairs that lie off by more than so many standard deviations (root mean square over the edges) weigh less."""

OUTLIER = 5.0
"""Pairs that lie off by more are wrong matches, and do not count."""

ROTATION_RAD, MOVE_SHARE, TIME_S = 0.035, 0.04, 0.15
"""Standard deviations before anything is seen: of each rotation, of each translation as a share of the size of the
objects (geometric mean of length and width: 0.1 m where there are cars), and of the time."""

HABIT_SHARE = 0.05
"""Standard deviation of how far the 2D boxes of a detector all reach too far, as a share of width and height."""

HEIGHT_SHARE, GROUND_SHARE = 0.07, 0.02
"""Standard deviations of a box's height and of the z of its underside, as shares of its height."""

FLOORS = np.array([0.0015, 0.0015, 0.003, 0.02, 0.02, 0.02, 0.004])
"""What recordings without any error show (docs/rig.md): an error is not known better than so. Radians, shares of the
size of the objects, seconds."""

STEPS = 4
"""Gauss-Newton steps; three are enough for two degrees. Wrong matches are left out in the second half."""

FIXED = 1e12
"""Information of a value that is zero."""

_SMALL = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 1e-3])
"""Steps of numeric derivatives: radians, metres, seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraError:
    """What the pairs say of one camera.

    Attributes:
        values: (7,) float64: rotation about x, y, z of its optical frame (radians), translation along them (metres):
            `motion(values) @ T_camera_site` is the pose that fits; and how much later than their stamps say its images
            were taken, seconds.
        sigmas: (7,) float64, their standard deviations; 0 of what was not free.
        size_m: Geometric mean of length and width of its objects, their median.
        pairs: Number of pairs that were used.
        tracks: Number of tracks they are of.
    """

    values: F64
    sigmas: F64
    size_m: float
    pairs: int
    tracks: int

    @property
    def units(self) -> F64:
        """(7,) 1 radian, the size of the objects (metres), 1 second: what limits are given in."""
        return np.array([1.0, 1.0, 1.0, self.size_m, self.size_m, self.size_m, 1.0])


def camera_error(
    pairs: TrackedPairs, camera: CameraSensor, lidar_xy: F64, config: FuseConfig, free: Bools | None = None
) -> CameraError | None:
    """The errors of a camera; None if there are too few pairs to judge it.

    Args:
        pairs: Of one camera.
        camera: As it is calibrated.
        lidar_xy: (L, 2) positions of the lidars in the site frame, metres.
        config: Outline of objects, and how well boxes are known.
        free: (7,) which values may differ from zero; None: all. What the others would take on belongs to these then.
    """
    if not _enough(pairs.tracks):
        return None
    fit = _Fit(pairs, camera, lidar_xy, config)
    is_free = np.ones(7, np.bool_) if free is None else free
    fit.prior[:7][~is_free] = FIXED
    values = np.zeros(10)
    for step in range(STEPS):
        away, slopes, valid = fit.whitened(values)
        squared = (away * away).mean(1)
        weights = np.minimum(1.0, HUBER / np.sqrt(np.maximum(squared, 1e-12)))
        weights[~valid | ((squared > OUTLIER**2) & (step >= STEPS // 2))] = 0.0
        normal = np.einsum("nei,n,nej->ij", slopes, weights, slopes) + np.diag(fit.prior)
        pull = np.einsum("nei,n,ne->i", slopes, weights, away) - fit.prior * values
        values = values + np.linalg.solve(normal, pull)
    used = weights > 0
    if not _enough(pairs.tracks[used]):
        return None
    scores = np.einsum("nei,n,ne->ni", slopes, weights, away)[used]
    spans = (pairs.stamps_ns - pairs.stamps_ns.min()) // int(CLUSTER_S * 1e9)
    covariance = cluster_covariance(scores, np.stack([pairs.tracks, spans], 1)[used], normal, fit.prior)
    floors = FLOORS * np.array([1, 1, 1, fit.size_m, fit.size_m, fit.size_m, 1])
    sigmas = np.hypot(np.sqrt(np.diag(covariance)[:7]), floors)
    return CameraError(
        values[:7] * is_free, sigmas * is_free, fit.size_m, int(used.sum()), len(np.unique(pairs.tracks[used]))
    )


def _enough(tracks: I64) -> bool:
    return len(tracks) >= MIN_PAIRS and len(np.unique(tracks)) >= MIN_TRACKS


class _Fit:
    """The pairs of a camera with all that does not depend on its error."""

    def __init__(self, pairs: TrackedPairs, camera: CameraSensor, lidar_xy: F64, config: FuseConfig) -> None:
        self._pairs, n = pairs, len(pairs)
        self._cameras = CameraArrays.of([camera]).select(np.zeros(n, np.int64))
        self._of_rig = camera.T_camera_site.matrix
        self._in_rig = camera.T_camera_site.inverse().matrix @ pairs.T_camera_site
        self._outline = rounded_outline(pairs.sizes, bent=self._cameras.lenses.bends)
        extent = np.maximum(pairs.xyxy[:, 2:] - pairs.xyxy[:, :2], 1.0)
        outline_px = config.outline_sigma * np.sqrt(extent.prod(1))
        self._noise_px2 = config.pixel_sigma_px**2 + outline_px**2
        self._reach = np.zeros((n, 4, 3))  # habits move left and right, top, bottom outwards
        self._reach[:, 0, 0], self._reach[:, 2, 0] = -extent[:, 0], extent[:, 0]
        self._reach[:, 1, 1], self._reach[:, 3, 2] = -extent[:, 1], extent[:, 1]
        self._box_covariances = self._known(lidar_xy, config)
        self.size_m = float(np.median(np.sqrt(pairs.sizes[:, :2].prod(1))))
        sigmas = [ROTATION_RAD] * 3 + [MOVE_SHARE * self.size_m] * 3 + [TIME_S] + [HABIT_SHARE] * 3
        self.prior = 1 / np.array(sigmas) ** 2

    def _known(self, lidar_xy: F64, config: FuseConfig) -> F64:
        """(P, 7, 7) covariances of the boxes over `projection.PARAMETERS`."""
        pairs, n = self._pairs, len(self._pairs)
        boxes = Boxes3D(
            0,
            "",
            pairs.centers,
            pairs.sizes,
            wrap_angle(pairs.yaws),
            np.ones(n, np.float32),
            np.zeros(n, np.int32),
            np.zeros(n, np.int32),
            pairs.covariances,
            np.full(n, Source.LIDAR.value, np.uint8),
            np.zeros(n, np.int64),
        )
        found = np.zeros((n, 7, 7))
        found[:, :5, :5] = box_prior(boxes, lidar_xy, config).covariances[:, :5, :5]
        found[:, :2, :2] += pairs.velocity_covariances * pairs.later_s[:, None, None] ** 2
        height = (HEIGHT_SHARE * pairs.sizes[:, 2]) ** 2
        found[:, 5, 5], found[:, 5, 6], found[:, 6, 5] = height, height / 2, height / 2
        found[:, 6, 6] = height / 4 + (GROUND_SHARE * pairs.sizes[:, 2]) ** 2
        return found

    def whitened(self, values: F64) -> tuple[F64, F64, Bools]:
        """How far the 2D boxes lie off, in standard deviations.

        Args:
            values: (10,) errors of the camera, and habits.

        Returns:
            (P, 4) of independent combinations of the edges; (P, 4, 10) derivatives of what is predicted of them; (P,)
            whether the object is wholly in front of the camera.
        """
        edges, by_box, valid = self._predicted(values[:7])
        predicted = edges + self._reach @ values[7:]
        slopes = np.concatenate([np.zeros((len(edges), 4, 7)), self._reach], 2)
        for k, step in enumerate(_SMALL):
            shifted = values[:7].copy()
            shifted[k] += step
            slopes[:, :, k] = (self._predicted(shifted)[0] - edges) / step
        covariances = by_box @ self._box_covariances @ by_box.swapaxes(1, 2)
        covariances[:, range(4), range(4)] += self._noise_px2[:, None]
        root = np.linalg.cholesky(covariances)
        away = np.linalg.solve(root, (self._pairs.xyxy - predicted)[..., None])[..., 0]
        return away, np.linalg.solve(root, slopes), valid

    def _later(self, time_s: float) -> F64:
        """(P, 4, 4) from the site at the frame's time to the site where the rig is so much later than the image."""
        own = self._pairs.own_motion
        if not time_s or not own.any():
            return self._in_rig
        back = np.tile(np.eye(4), (len(own), 1, 1))
        back[:, :3, :3], back[:, :3, 3] = turned(-own[:, 3:] * time_s), -own[:, :3] * time_s
        return np.asarray(back @ self._in_rig)

    def _predicted(self, values: F64) -> tuple[F64, F64, Bools]:
        """Edges (P, 4), their derivatives (P, 4, 7) by the boxes, and whether they are valid (P,), without habits."""
        pairs, later_s = self._pairs, self._pairs.later_s + values[6]
        centers = pairs.centers.copy()
        centers[:, :2] += pairs.velocities * later_s[:, None]
        T_camera_site = motion(values) @ self._of_rig @ self._later(float(values[6]))
        rotations, translations = T_camera_site[:, :3, :3].copy(), T_camera_site[:, :3, 3].copy()
        cameras = replace(self._cameras, rotations=rotations, translations=translations)
        return project_edges(centers, pairs.sizes, pairs.yaws + pairs.yaw_rates * later_s, cameras, self._outline)
