"""Errors of one camera's pose and clock, by robust least squares over the pairs of a run.

An object placed by the lidars alone is moved by its track to the time of the image and projected; the edges of its 2D
box should be there. The unknowns are a small rotation and translation of the camera, the delay of its images against
their stamps, and the habits of its detector: the share of width and height by which 2D boxes exceed the outline of the
object (left and right alike, top and bottom each). Objects that cross the image at different speeds separate time from
yaw.

The weight of an edge follows from its uncertainty: of the pixels and the outline (`fuse.pixel_sigma_px`,
`fuse.outline_sigma`) and of the lidar's box (`box_prior`), whose unseen end is uncertain. Pairs with large residuals
weigh less (Huber, 1964). Boxes of one track have a common error as long as the camera sees the same side of the object,
so the covariance counts these as one group: a parked car that is seen for a minute is one witness.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from lidcam.pipeline.calibration.motions import jackknife_covariance, motion
from lidcam.pipeline.calibration.pairs import TrackedPairs
from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.rotations import pose_matrix, turned
from lidcam.pipeline.core.rig import HABIT_SIGMA, CameraFit, CameraSensor, EdgeHabits
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.projection import CameraArrays, project_edges, rounded_outline
from lidcam.pipeline.fusion.refining.box_prior import box_prior
from lidcam.pipeline.fusion.refining.edges import excess_slopes

MIN_PAIRS = 20
"""Minimum number of pairs before a camera is judged."""

MIN_TRACKS = 2
"""Minimum number of tracks that these pairs belong to."""

MIN_WITNESSES = 3
"""Minimum number of sides of these tracks that the camera sees: two show no spread."""

HUBER = 1.5
"""Residual, in standard deviations (root mean square over the edges), beyond which pairs weigh less."""

MAX_RESIDUAL = 5.0
"""Maximum residual, in standard deviations; pairs beyond are wrong matches and are left out."""

ROTATION_SIGMA_RAD = 0.035
"""Prior standard deviation of each rotation, radians."""

TRANSLATION_SIGMA = 0.04
"""Prior standard deviation of each translation, as a share of the object size (0.1 m among cars)."""

TIME_SIGMA_S = 0.15
"""Prior standard deviation of the time offset, seconds."""

HABIT_SIGMA_PX = 1.5
"""Prior standard deviation of the excess at each edge that is the same for boxes of all sizes, pixels."""

NOISE_FACTORS = np.sqrt(2.0) ** np.arange(7)
"""Factors by which the noise of edges may exceed that of the settings."""

NOISE_FACTOR_SIGMA = 0.7
"""Prior standard deviation of the logarithm of such a factor."""

NOISE_FREEDOM = 4.0
"""Degrees of freedom of the t distribution by which the noise is judged: there are wrong matches."""

NOISE_CORRELATION = 4.0
"""Number of consecutive pairs of a track with the information of one."""

GROUND_SIGMA = 0.02
"""Standard deviation of the z of a box's underside, as a share of its height."""

MIN_SIGMAS = np.array([0.0015, 0.0015, 0.006, 0.02, 0.02, 0.02, 0.004])
"""Errors that recordings without any error show (docs/rig.md): radians, shares of the object size, seconds."""

STEPS = 4
"""Number of Gauss-Newton steps; three are enough for two degrees. Wrong matches are left out in the second half."""

FIXED_INFORMATION = 1e12
"""Information of a value that is kept at zero."""

_DERIVATIVE_STEPS = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 1e-3])
"""Steps of numeric derivatives: radians, metres, seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraError:
    """The estimated error of one camera."""

    # (7,) float64: rotation about x, y, z of its optical frame (radians) and translation along them (metres), so that
    # `motion(values) @ T_camera_site` is the pose that fits; delay of the images against their stamps, seconds
    values: F64
    covariance: F64  # (7, 7) float64
    habit_sigma: float  # Standard deviation of the largest of the shares among them
    habits: EdgeHabits  # Excess of the 2D boxes over the outlines of objects
    # Standard deviations of left and right edges, and of upper and lower ones: pixels, and a share of the root of the
    # area of the 2D box
    noise: tuple[tuple[float, float], tuple[float, float]]
    size_m: float  # Object size: median of the geometric mean of length and width, metres
    pairs: int  # Number of pairs used
    tracks: int  # Number of tracks they belong to

    @property
    def sigmas(self) -> F64:
        """(7,) standard deviations; 0 for values that were not free."""
        return np.sqrt(np.diag(self.covariance))

    def applied_to(self, camera: CameraSensor) -> CameraSensor:
        """The camera without the estimated error, as far as it exceeds its uncertainty.

        The error is shrunk by the James-Stein estimate of its share that is not noise (James and Stein, Estimation with
        quadratic loss, 1961): what is no larger than its uncertainty is left alone. What the camera was turned by
        before counts as corrected, too.
        """
        free = self.sigmas > 0
        surprise = self.values[free] @ np.linalg.solve(self.covariance[np.ix_(free, free)], self.values[free])
        values = self.values * max(0.0, 1 - free.sum() / max(float(surprise), 1e-12))
        pose = replace(camera.T_camera_site, matrix=motion(values) @ camera.T_camera_site.matrix)
        direction_sigma_rad = float(max(self.sigmas[:2].max(), MIN_SIGMAS[0]))
        if not values.any():  # a recording that shows little is no reason to trust the camera less
            direction_sigma_rad = min(direction_sigma_rad, camera.fit.direction_sigma_rad)
        fit = CameraFit(
            tuple((values + camera.fit.corrected).tolist()),
            direction_sigma_rad,
            float(self.sigmas[6]),
            self.habits,
            self.habit_sigma,
            self.noise,
            camera.fit.zoom,
        )
        # Stamps are later than the images by the offset: images taken later than assumed have a smaller one.
        offset_ns = camera.time_offset_ns - round(float(values[6]) * 1e9)
        return replace(camera, T_camera_site=pose, time_offset_ns=offset_ns, fit=fit)

    @property
    def units(self) -> F64:
        """(7,) units of limits: radian, object size in metres, second."""
        return np.array([1.0, 1.0, 1.0, self.size_m, self.size_m, self.size_m, 1.0])


def camera_error(
    pairs: TrackedPairs, camera: CameraSensor, lidar_xyz: F64, config: FuseConfig, free: Bools | None = None
) -> CameraError | None:
    """The errors of a camera; None if there are too few pairs to judge it.

    Args:
        pairs: Pairs of this camera.
        camera: As calibrated.
        lidar_xyz: (L, 3) positions of the lidars in the site frame, metres.
        config: Outline of objects and uncertainty of boxes.
        free: (7,) values that may differ from zero; None: all.
    """
    pairs = pairs.select(_Fit(pairs, camera, lidar_xyz, config).are_whole())
    groups = np.stack([pairs.tracks, _seen_sides(pairs)], 1)
    if not _has_enough(groups):
        return None
    fit = _Fit(pairs, camera, lidar_xyz, config)
    is_free = np.ones(7, np.bool_) if free is None else free
    fit.prior[:7][~is_free] = FIXED_INFORMATION
    values = np.zeros(len(fit.prior))
    for step in range(STEPS):
        if step == STEPS // 2:
            fit.learn_noise(values)
        residuals, slopes, valid = fit.whitened(values)
        squared = (residuals * residuals).mean(1)
        weights = np.minimum(1.0, HUBER / np.sqrt(np.maximum(squared, 1e-12)))
        weights[~valid | ((squared > MAX_RESIDUAL**2) & (step >= STEPS // 2))] = 0.0
        normal = np.einsum("nei,n,nej->ij", slopes, weights, slopes) + np.diag(fit.prior)
        pull = np.einsum("nei,n,ne->i", slopes, weights, residuals) - fit.prior * values
        values = values + np.linalg.solve(normal, pull)
    used = weights > 0
    if not _has_enough(groups[used]):
        return None
    scores = np.einsum("nei,n,ne->ni", slopes, weights, residuals)
    information = np.einsum("nei,n,nej->nij", slopes, weights, slopes)
    covariance = jackknife_covariance(scores[used], information[used], groups[used], normal, fit.prior)
    min_sigmas = MIN_SIGMAS * np.array([1, 1, 1, fit.size_m, fit.size_m, fit.size_m, 1])
    return CameraError(
        values=values[:7] * is_free,
        covariance=np.outer(is_free, is_free) * (covariance[:7, :7] + np.diag(min_sigmas**2)),
        habit_sigma=min(float(np.sqrt(np.diag(covariance)[7:10].max())), HABIT_SIGMA),
        habits=EdgeHabits(*values[7:].tolist()),
        noise=(fit.noise[0], fit.noise[1]),
        size_m=fit.size_m,
        pairs=int(used.sum()),
        tracks=len(np.unique(pairs.tracks[used])),
    )


def _has_enough(groups: I64) -> bool:
    tracks, witnesses = np.unique(groups[:, 0]), np.unique(groups, axis=0)
    return len(groups) >= MIN_PAIRS and len(tracks) >= MIN_TRACKS and len(witnesses) >= MIN_WITNESSES


def _seen_sides(pairs: TrackedPairs) -> I64:
    """(P,) side of the object that faces the camera: quarter turns to the left from its front."""
    rotations, translations = pairs.T_camera_site[:, :3, :3], pairs.T_camera_site[:, :3, 3]
    towards = -np.einsum("nji,nj->ni", rotations, translations) - pairs.centers
    angles = np.arctan2(towards[:, 1], towards[:, 0]) - pairs.yaws
    return np.asarray(np.round(angles / (np.pi / 2)).astype(np.int64) % 4)


class _Fit:
    """The least-squares problem of a camera: its pairs, and everything that does not depend on its error."""

    def __init__(self, pairs: TrackedPairs, camera: CameraSensor, lidar_xyz: F64, config: FuseConfig) -> None:
        self._pairs, n = pairs, len(pairs)
        self._cameras = CameraArrays.of([camera]).select(np.zeros(n, np.int64))
        self._T_camera_site = camera.T_camera_site.matrix
        self._T_image_site = camera.T_camera_site.inverse().matrix @ pairs.T_camera_site
        self._outline = rounded_outline(pairs.sizes, bent=self._cameras.lenses.bends)
        extent = np.maximum(pairs.xyxy[:, 2:] - pairs.xyxy[:, :2], 1.0)
        self._area_px2 = extent.prod(1)
        self._config = config
        self.noise = [(config.pixel_sigma_px, config.outline_sigma)] * 2
        self._habits = excess_slopes(extent)
        self._box_covariances = self._covariances_of_boxes(lidar_xyz)
        self.size_m = float(np.median(np.sqrt(pairs.sizes[:, :2].prod(1))))
        of_pose = [ROTATION_SIGMA_RAD] * 3 + [TRANSLATION_SIGMA * self.size_m] * 3 + [TIME_SIGMA_S]
        self.prior = 1 / np.array([*of_pose, *[HABIT_SIGMA] * 3, HABIT_SIGMA_PX]) ** 2

    def _covariances_of_boxes(self, lidar_xyz: F64) -> F64:
        """(P, 7, 7) covariances of the boxes over `projection.PARAMETERS`."""
        pairs, n = self._pairs, len(self._pairs)
        boxes = Boxes3D(
            stamp_ns=0,
            frame_id="",
            centers=pairs.centers,
            sizes=pairs.sizes,
            yaws=wrap_angle(pairs.yaws),
            scores=np.ones(n, np.float32),
            class_ids=np.zeros(n, np.int32),
            point_counts=np.zeros(n, np.int32),
            covariances=pairs.covariances,
            sources=np.full(n, Source.LIDAR.value, np.uint8),
            measured_ns=np.zeros(n, np.int64),
        )
        covariances = np.zeros((n, 7, 7))
        covariances[:, :6, :6] = box_prior(boxes, lidar_xyz, self._config).covariances[:, :6, :6]
        covariances[:, :2, :2] += pairs.velocity_covariances * pairs.later_s[:, None, None] ** 2
        height = covariances[:, 5, 5]
        covariances[:, 5, 6] = covariances[:, 6, 5] = height / 2
        covariances[:, 6, 6] = height / 4 + (GROUND_SIGMA * pairs.sizes[:, 2]) ** 2
        return covariances

    def are_whole(self) -> Bools:
        """(P,) whether the image shows all of each object: the 2D box of a part may end short of its border."""
        edges, _, valid = self._predicted(np.zeros(7))
        return np.asarray(valid & (edges >= 0).all(1) & (edges <= self._cameras.limits).all(1))

    def whitened(self, values: F64) -> tuple[F64, F64, Bools]:
        """Whitened residuals of the 2D boxes.

        Args:
            values: Errors of the camera (7,), and habits (4,).

        Returns:
            (P, 4) residuals of independent combinations of the edges, in standard deviations; (P, 4, 11) derivatives of
            their predictions; (P,) whether the object is wholly in front of the camera.
        """
        edges, by_box, valid = self._predicted(values[:7])
        predicted = edges + self._habits @ values[7:]
        slopes = np.concatenate([np.zeros((len(edges), 4, 7)), self._habits], 2)
        for k, step in enumerate(_DERIVATIVE_STEPS):
            shifted = values[:7].copy()
            shifted[k] += step
            slopes[:, :, k] = (self._predicted(shifted)[0] - edges) / step
        covariances = by_box @ self._box_covariances @ by_box.swapaxes(1, 2)
        noise_px2 = np.array([pixel_px**2 + outline**2 * self._area_px2 for pixel_px, outline in self.noise * 2])
        root = np.linalg.cholesky(covariances + noise_px2.T[:, None] * np.eye(4))
        residuals = np.linalg.solve(root, (self._pairs.xyxy - predicted)[..., None])[..., 0]
        return np.asarray(residuals, np.float64), np.linalg.solve(root, slopes), valid

    def learn_noise(self, values: F64) -> None:
        """Set the noise of edges to the likeliest, by the residuals at `values` and the prior of the factors."""
        edges, by_box, valid = self._predicted(values[:7])
        residuals = (self._pairs.xyxy - edges - self._habits @ values[7:])[valid]
        of_boxes = (by_box @ self._box_covariances @ by_box.swapaxes(1, 2))[valid]
        pixel_px, outline = self._config.pixel_sigma_px, self._config.outline_sigma
        for axis in range(2):
            residual, of_box, best = residuals[:, axis::2], of_boxes[:, axis::2, axis::2], -np.inf
            for one, other in product(NOISE_FACTORS, NOISE_FACTORS):
                noise_px2 = (one * pixel_px) ** 2 + (other * outline) ** 2 * self._area_px2[valid]
                covariances = of_box + noise_px2[:, None, None] * np.eye(2)
                squared = (residual * np.linalg.solve(covariances, residual[..., None])[..., 0]).sum(1)
                spread = np.log1p(squared / NOISE_FREEDOM) * (NOISE_FREEDOM + 2) / 2
                likelihood = -(np.linalg.slogdet(covariances)[1] / 2 + spread).sum() / NOISE_CORRELATION
                likelihood -= (np.log(one) ** 2 + np.log(other) ** 2) / NOISE_FACTOR_SIGMA**2 / 2
                if likelihood > best:
                    best, self.noise[axis] = likelihood, (float(one * pixel_px), float(other * outline))

    def _T_later_site(self, delay_s: float) -> F64:
        """(P, 4, 4) from the site at the frame's time to the site as it stands `delay_s` after the image's stamp."""
        twist = self._pairs.own_motion
        if not delay_s or not twist.any():
            return self._T_image_site
        back = pose_matrix(turned(-twist[:, 3:] * delay_s), -twist[:, :3] * delay_s)
        return np.asarray(back @ self._T_image_site)

    def _predicted(self, values: F64) -> tuple[F64, F64, Bools]:
        """Edges (P, 4), their derivatives (P, 4, 7) by the boxes, and whether they are valid (P,), without habits."""
        pairs, later_s = self._pairs, self._pairs.later_s + values[6]
        centers = pairs.centers.copy()
        centers[:, :2] += pairs.velocities * later_s[:, None]
        T_camera_site = motion(values) @ self._T_camera_site @ self._T_later_site(float(values[6]))
        rotations, translations = T_camera_site[:, :3, :3].copy(), T_camera_site[:, :3, 3].copy()
        cameras = replace(self._cameras, rotations=rotations, translations=translations)
        return project_edges(centers, pairs.sizes, pairs.yaws + pairs.yaw_rates * later_s, cameras, self._outline)
