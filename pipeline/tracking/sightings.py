"""Input and output of trackers, in the fixed frame: the sightings of a frame, and its tracks."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, U8, Bools, Table, join_rows
from lidcam.pipeline.core.geometry.boxes import rotations_2d
from lidcam.pipeline.fusion.refining.box_prior import MAX_SIZE_SIGMA, MIN_ANCHOR, SEEN_SIZE_SIGMA
from lidcam.pipeline.tracking.motion import NO_AXIS_VARIANCE, Priors

NOT_SEEN = -1
"""Sighting of a track that the frame does not show."""

SHARED_ERROR = 0.1
"""Share of the variance of a measurement that all measurements of a track have in common.

Measured: with 0.1, 0.97 to 1.0 of the cars of KITTI drive 0009 and of six simulated recordings with errors lie in their
95 % ellipses (0.9 in one); with 0.5 the ellipses were twice as large as the errors, and 0.99 to 1.0 in them.
"""

MIN_MEASUREMENTS = 3
"""Fewest sightings of a track whose speed is known: of two, one box that is completed otherwise is a motion."""

MIN_FRONT_TRAVEL = 0.75
"""Minimum travel, in motion scales, before it defines the front; boxes of few points wander by half a length."""

FRONT_PRIOR_VOTES = 0.5
"""Votes for each end before any box (Jeffreys' prior of a share)."""

FORWARD_LOG_ODDS = 1.5
"""Log odds that a vehicle that moved a little went forwards: one of five such movements is out of a parking space."""

MEAN_REVERSE_TRAVEL = 1.5
"""Mean travel in reverse, in motion scales."""

UNKNOWN_SIGMA = 0.05
"""Standard deviation of the position of boxes without covariance, as a share of the class length."""

UNKNOWN_YAW_SIGMA_RAD = 0.1
"""Standard deviation of the yaw of boxes without covariance, radians."""

JUMP_SIGMA = 0.04
"""Standard deviation that the completion of boxes adds to their positions, as a share of the class length."""

EXTRA_YAW_SIGMA_RAD = 0.03
"""Standard deviation added to the yaw of every box, radians."""

WEAK_NOISE = 30.0
"""Factor of the variances of a box that shows its object poorly: one that the frame by itself does not report may be
another thing's, or turned, and one of a shorter class than its track's is a part, which may be either end."""

MAX_LENGTH_RATIO = 1.5
"""Maximum ratio of the length of another class, whose boxes count for the size of a track, to that of its class: in
some frames a lorry is a bus. Boxes of shorter classes are parts."""

NO_BELIEF = 1e-9
"""Weight of the size of a box that does not show the whole object: only where no other box does, it counts."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings(Table):
    """N objects that a frame may show."""

    rows: I64  # (N,) int64, row of the hypothesis
    boxes: F64  # (N, 3) float64, x, y of the centre and yaw, in the fixed frame
    heights_m: F64  # (N,) float64, z of the centre
    sizes: F64  # (N, 3) float64, length, width, height, metres
    covariances: F64  # (N, 3, 3) float64 of `boxes`; zeros where unknown
    later_s: F64  # (N,) float64, time of measurement after the stamp of the frame
    beliefs: F64  # (N,) float64, probability of an object of the class at this place
    class_ids: I64  # (N,) int64
    are_reported: Bools  # (N,) bool, whether the frame by itself reports it
    matched: I32  # (N,) int32, number of cameras that matched it
    point_counts: I32  # (N,) int32
    sources: U8  # (N,) uint8
    # (N, 2) float64 in [-1, 1], position of the lidars along its length and width: 1 beyond its front, or its left side
    sides: F64
    side_views: F64  # (N, 2) float64, sines of the angles between the view of the lidars and its length and width
    show_front: Bools  # (N,) bool, whether the yaw tells front from rear, as that of clusters and of 2D boxes does not

    @property
    def undersides_m(self) -> F64:
        """(N,) z of their undersides, metres."""
        return self.heights_m - self.sizes[:, 2] / 2


@dataclass(frozen=True, slots=True, eq=False)
class FrameSightings:
    """The sightings of one frame, with its time and its pose (4, 4)."""

    stamp_ns: int
    T_fixed_site: F64
    sightings: Sightings


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The sightings of a stretch of frames."""

    stamps_ns: I64  # (F,) int64, times of the frames
    stamps_s: F64  # (F,) times since the first frame
    sites_xy: F64  # (F, 2) positions of the rig
    sightings: Sightings  # N sightings, frame by frame
    frames: I64  # (N,) frame of each
    starts: I64  # (F + 1,) first sighting of each frame, and N

    @classmethod
    def of(cls, frames: list[FrameSightings]) -> Self:
        """The scene of one frame or more, whose stamps rise."""
        counts = np.array([len(frame.sightings) for frame in frames])
        stamps_ns = np.array([frame.stamp_ns for frame in frames], np.int64)
        return cls(
            stamps_ns=stamps_ns,
            stamps_s=(stamps_ns - stamps_ns[0]) / 1e9,
            sites_xy=np.array([frame.T_fixed_site[:2, 3] for frame in frames]),
            sightings=join_rows(*[frame.sightings for frame in frames]),
            frames=np.repeat(np.arange(len(frames)), counts),
            starts=np.concatenate([[0], np.cumsum(counts)]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class TrackRows(Table):
    """N tracks in one frame, by rising number."""

    ids: I64  # (N,) int64
    # (N, 5) float64, as in `lidcam.pipeline.tracking.motion`, at the frame's stamp; positions are those of the centres
    states: F64
    covariances: F64  # (N, 5, 5) float64
    rear_m: F64  # (N,) float64, distance of the rear axle, whose speed that of the state is, behind the centre
    heights_m: F64  # (N,) float64, z of the centre
    sizes: F64  # (N, 3) float64
    class_ids: I64  # (N,) int64
    existence: F64  # (N,) float64
    ages_s: F64  # (N,) float64
    fronts_known: Bools  # (N,) bool
    speeds_known: Bools  # (N,) bool, whether there are measurements enough, and the class can be so fast
    seen: I64  # (N,) int64, row of the frame's `Sightings`, or `NOT_SEEN`

    @classmethod
    def none(cls) -> Self:
        """No track."""
        zeros, numbers, no = np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.bool_)
        states, covariances = np.zeros((0, 5)), np.zeros((0, 5, 5))
        return cls(numbers, states, covariances, zeros, zeros, np.zeros((0, 3)), numbers, zeros, zeros, no, no, numbers)

    @property
    def are_seen(self) -> Bools:
        """(N,) whether the frame shows each."""
        return np.asarray(self.seen != NOT_SEEN)


def measurement_covariances(sightings: Sightings, priors: Priors) -> F64:
    """(N, 3, 3) covariances of the boxes of sightings as measurements.

    Args:
        sightings: N sightings.
        priors: All classes.
    """
    of_class = priors.select(sightings.class_ids)
    noise = sightings.covariances.copy()
    unknown = ~noise.any((1, 2))
    noise[unknown, 0, 0] = noise[unknown, 1, 1] = (UNKNOWN_SIGMA * of_class.lengths_m[unknown]) ** 2
    noise[unknown, 2, 2] = UNKNOWN_YAW_SIGMA_RAD**2
    jump = (JUMP_SIGMA * of_class.lengths_m) ** 2
    noise[:, 0, 0] += jump
    noise[:, 1, 1] += jump
    noise[:, 2, 2] = np.where(of_class.show_axis, noise[:, 2, 2] + EXTRA_YAW_SIGMA_RAD**2, NO_AXIS_VARIANCE)
    noise[:, :2, 2] = noise[:, 2, :2] = 0.0
    return noise


def shows_part(class_ids: I64, track_class_ids: I64, priors: Priors) -> Bools:
    """(N,) whether boxes of these classes are parts of objects of the classes of their tracks, which are longer."""
    return np.asarray(priors.lengths_m[class_ids] < priors.lengths_m[track_class_ids])


def shows_whole(class_ids: I64, track_class_ids: I64, priors: Priors) -> Bools:
    """Whether boxes of these classes show the size of objects of the classes of their tracks; shapes as broadcast."""
    ratios = priors.lengths_m[class_ids] / priors.lengths_m[track_class_ids]
    return np.asarray((ratios >= 1.0) & (ratios < MAX_LENGTH_RATIO))


def size_weights(sightings: Sightings, beliefs: F64, are_solid: Bools) -> F64:
    """(N, 3) weights of the sizes of boxes in those of their tracks.

    They rise with the number of points and with how well the covariances say that both ends were seen.

    Args:
        sightings: N sightings.
        beliefs: (N,) probabilities that the box shows the whole object.
        are_solid: (N,) whether points show both ends of the class of the track.
    """
    weights = np.tile((beliefs * np.maximum(sightings.point_counts, 1))[:, None], 3)
    of_sides = sightings.side_views * (sightings.sizes[:, :2] / extent_sigmas_m(sightings)) ** 2
    weights[:, :2] *= np.where(are_solid[:, None], of_sides, 1.0)
    return weights


def extent_sigmas_m(sightings: Sightings) -> F64:
    """(N, 2) standard deviations of length and width by the covariances of the boxes.

    Where a side was not seen, the middle is as uncertain along the box as half the extent; where both were, it is no
    more so than across.
    """
    turn, extents = rotations_2d(sightings.boxes[:, 2]), sightings.sizes[:, :2]
    variances = np.diagonal(turn.swapaxes(1, 2) @ sightings.covariances[:, :2, :2] @ turn, axis1=1, axis2=2)
    levers = np.maximum(np.abs(sightings.sides) / 2, MIN_ANCHOR)
    sigmas_m = np.sqrt(variances - variances.min(1, keepdims=True)) / levers
    return np.asarray(np.clip(sigmas_m, SEEN_SIZE_SIGMA * extents, MAX_SIZE_SIGMA * extents))


def forward_log_odds(along_m: F64, scales_m: F64) -> F64:
    """(N,) log odds that the front is where the heading points, of vehicles that moved along it by `along_m` (N,)."""
    return np.sign(along_m) * (FORWARD_LOG_ODDS + np.abs(along_m) / (MEAN_REVERSE_TRAVEL * scales_m))
