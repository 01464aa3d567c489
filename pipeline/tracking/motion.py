"""How road users move: a coordinated turn of constant speed and yaw rate, for many tracks at once.

A state (5) is x, y, heading, speed along the heading (negative: backwards) and yaw rate. Its position is that of the
rear axle of a vehicle, which does not slip sideways: a turn about the centre of a box would be wrong by the slip angle,
7 degrees in tight curves. A measurement (3) is x, y and yaw of a box, modulo 180 degrees as its front is unknown. It
has its own covariance and its own time, up to 0.1 s beside the frame's.

Source: Schubert et al., Comparison and evaluation of advanced motion models for vehicle tracking, FUSION 2008 (CTRV).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools, Table
from lidcam.pipeline.core.settings.classes import ClassPrior

STATE = 5
"""Length of a state."""

HEADING, SPEED, TURN = 2, 3, 4
"""Columns of heading, speed and yaw rate in a state."""

REAR_SHARE = 0.28
"""Distance of the rear axle of a vehicle behind its centre, as a share of its length."""

MAX_SCALE_M = 4.0
"""Maximum motion scale, metres: longer vehicles accelerate no faster than one of this length."""

LATERAL_M_S2 = 3.0
"""Standard deviation of the change of a vehicle's lateral acceleration within a second, m/s^2."""

ROBUST_DISTANCE = 9.0
"""Squared Mahalanobis distance beyond which a box weighs less."""

NO_AXIS_VARIANCE = 100.0
"""Yaw variance of boxes that show no axis, rad^2: they carry no heading."""

DRIVING_SIGMAS = 3.0
"""Minimum speed of a vehicle that drives, in standard deviations of the speed."""

MAX_TURN_RAD = np.deg2rad(30.0)
"""Maximum difference of the heading of a box from that of a vehicle that drives, for the box to show its axis."""

MAX_ALIKE = 1.5
"""Maximum length of objects that are of about one length, in usual lengths of their class."""

_IDENTITY = np.eye(STATE)


@dataclass(frozen=True, slots=True, eq=False)
class Priors(Table):
    """Motion priors of each class, from its size alone: the same for a car of 1:14 and for a bus."""

    lengths_m: F64  # (C,) length of the class, metres
    scales_m: F64  # (C,) unit of length of its motion, metres; limited, as long vehicles are no faster
    # (C, 5) densities of acceleration, yaw acceleration, position and heading, and the speed, m/s, below which
    # it turns less the slower it is, and not at all when standing; 0 for people
    noise: F64
    speeds: F64  # (C,) standard deviation of the speed at the first sighting, m/s
    show_axis: Bools  # (C,) bool, whether the box shows the axis of the motion, as it does not for people on foot
    are_solid: Bools  # (C,) bool, whether points show both ends, as thin wheels and limbs do not
    are_alike: Bools  # (C,) bool, whether all are of about one length, as cars are and trucks are not

    @classmethod
    def of_classes(cls, classes: Sequence[ClassPrior]) -> Self:
        """The priors of classes, row by class id."""
        sizes_m = np.array([prior.size_m for prior in classes])
        lengths, widths, heights = sizes_m.T
        walks = lengths < 1.5 * widths
        # People accelerate as if they were three times as long.
        scales = np.where(walks, 3.0 * lengths, np.minimum(lengths, MAX_SCALE_M))
        noise = np.stack(
            [
                (0.5 * scales) ** 2,
                np.where(walks, 3.0, 5.0),
                (0.02 * scales) ** 2,
                np.where(walks, 0.3, 0.01),
                np.where(walks, 0.0, scales),
            ],
            1,
        )
        return cls(
            lengths_m=lengths,
            scales_m=scales,
            noise=noise,
            speeds=np.where(walks, 0.8, 2.5) * scales,
            show_axis=~walks,
            are_solid=~walks & (heights < 2 * widths),
            are_alike=np.array([prior.max_size_m[0] for prior in classes]) <= MAX_ALIKE * lengths,
        )

    @property
    def max_speeds(self) -> F64:
        """(C,) speed that nothing of the class reaches, m/s."""
        return np.where(self.show_axis, 20.0, 7.0) * self.scales_m

    def rear_m(self, lengths_m: F64) -> F64:
        """(N,) distances of the rear axles behind the centres, for objects of the classes of these rows."""
        return np.where(self.show_axis, REAR_SHARE * lengths_m, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Motions(Table):
    """States (N, 5) of N tracks, and their covariances (N, 5, 5)."""

    states: F64
    covariances: F64


def predicted(motions: Motions, after_s: F64 | float, noise: F64) -> tuple[Motions, F64]:
    """Tracks some seconds later ((N,) or one number, may be negative), and the derivatives (N, 5, 5) of their states.

    `noise` (N, 5) is that of `Priors`.
    """
    after_s = np.broadcast_to(np.asarray(after_s, np.float64), (len(motions),))
    states, slopes = _turned(motions.states, after_s)
    covariances = slopes @ motions.covariances @ slopes.swapaxes(1, 2)
    covariances += _process_noise(motions.states, after_s, noise)
    return Motions(states, covariances), slopes


def expected(motions: Motions, later_s: F64, rear_m: F64) -> tuple[F64, F64]:
    """Boxes (N, 3) expected some seconds (N,) after the states, and their derivatives (N, 3, 5) by the states."""
    states, slopes = _turned(motions.states, later_s)
    positions, derivatives = states[:, :3].copy(), slopes[:, :3].copy()
    cos, sin = np.cos(positions[:, 2]), np.sin(positions[:, 2])
    positions[:, 0] += rear_m * cos
    positions[:, 1] += rear_m * sin
    derivatives[:, 0] -= (rear_m * sin)[:, None] * slopes[:, HEADING]
    derivatives[:, 1] += (rear_m * cos)[:, None] * slopes[:, HEADING]
    return positions, derivatives


def innovations(motions: Motions, boxes: F64, later_s: F64, rear_m: F64) -> tuple[F64, F64]:
    """Boxes (N, 3) minus those that are `expected`, and the derivatives of these.

    Differences of yaws are modulo 180 degrees, in (-pi/2, pi/2].
    """
    expected_boxes, derivatives = expected(motions, later_s, rear_m)
    difference = boxes - expected_boxes
    difference[:, 2] = np.pi / 2 - (np.pi / 2 - difference[:, 2]) % np.pi
    return difference, derivatives


def updated(motions: Motions, difference: F64, derivatives: F64, noise: F64, robust: float = np.inf) -> Motions:
    """Tracks after a measurement each (Kalman update in Joseph's form).

    Args:
        motions: N tracks.
        difference: (N, M) innovations: measured minus expected.
        derivatives: (N, M, 5) of the expected measurements by the states.
        noise: (N, M, M) covariances of the measurements.
        robust: Squared Mahalanobis distance beyond which a measurement weighs less, as from a heavy-tailed
            distribution.
    """
    projected = motions.covariances @ derivatives.swapaxes(1, 2)
    spread = derivatives @ projected + noise
    if np.isfinite(robust):
        excess = (difference * np.linalg.solve(spread, difference[..., None])[..., 0]).sum(1) / robust
        noise = noise * np.maximum(excess, 1.0)[:, None, None]
        spread = derivatives @ projected + noise
    gains = np.linalg.solve(spread, projected.swapaxes(1, 2)).swapaxes(1, 2)
    kept = _IDENTITY - gains @ derivatives
    covariances = kept @ motions.covariances @ kept.swapaxes(1, 2) + gains @ noise @ gains.swapaxes(1, 2)
    return Motions(motions.states + (gains @ difference[..., None])[..., 0], covariances)


def with_known_axes(noise: F64, difference: F64, motions: Motions, rolling_m_s: F64) -> F64:
    """The covariances (N, 3, 3) of boxes, without the headings of those across the way of a vehicle that drives.

    Their length was taken for their width, or two corners for a side: none turns so far within a frame. `difference`
    (N, 3) are the innovations, `rolling_m_s` (N,) is the last column of the noise of `Priors`.
    """
    sigmas = np.sqrt(motions.covariances[:, SPEED, SPEED])
    drives = np.abs(motions.states[:, SPEED]) > np.maximum(rolling_m_s, DRIVING_SIGMAS * sigmas)
    is_across = drives & (rolling_m_s > 0) & (np.abs(difference[:, 2]) > MAX_TURN_RAD)
    noise = noise.copy()
    noise[is_across, 2, 2] = NO_AXIS_VARIANCE
    return noise


def with_possible_turns(motions: Motions, rolling_m_s: F64) -> Motions:
    """The same tracks, with yaw rates (N,) within what a turning radius of one motion scale allows at their speed.

    `rolling_m_s` (N,) is the last column of the noise of `Priors`; where it is 0, any yaw rate is possible.
    """
    rolling = np.maximum(rolling_m_s, 1e-9)
    max_rad_s = np.where(rolling_m_s > 0, np.abs(motions.states[:, SPEED]) / rolling, np.inf)
    states = motions.states.copy()
    states[:, TURN] = np.clip(states[:, TURN], -max_rad_s, max_rad_s)
    return Motions(states, motions.covariances)


def at_centers(motions: Motions, rear_m: F64) -> Motions:
    """The same tracks with positions of box centres, `rear_m` (N,) ahead of the rear axles."""
    cos, sin = np.cos(motions.states[:, HEADING]), np.sin(motions.states[:, HEADING])
    states = motions.states.copy()
    states[:, 0] += rear_m * cos
    states[:, 1] += rear_m * sin
    slopes = np.broadcast_to(_IDENTITY, (len(states), STATE, STATE)).copy()
    slopes[:, 0, HEADING], slopes[:, 1, HEADING] = -rear_m * sin, rear_m * cos
    return Motions(states, slopes @ motions.covariances @ slopes.swapaxes(1, 2))


def at_rear_axles(motions: Motions, rear_m: F64) -> Motions:
    """The inverse of `at_centers`."""
    return at_centers(motions, -rear_m)


def _turned(states: F64, after_s: F64) -> tuple[F64, F64]:
    """States (N, 5) some seconds (N,) later and their derivatives (N, 5, 5); a step goes along its middle heading."""
    middle = states[:, HEADING] + states[:, TURN] * after_s / 2
    cos, sin, speed = np.cos(middle), np.sin(middle), states[:, SPEED]
    later = states.copy()
    later[:, 0] += speed * cos * after_s
    later[:, 1] += speed * sin * after_s
    later[:, HEADING] += states[:, TURN] * after_s
    slopes = np.broadcast_to(_IDENTITY, (len(states), STATE, STATE)).copy()
    slopes[:, 0, HEADING], slopes[:, 1, HEADING] = -speed * sin * after_s, speed * cos * after_s
    slopes[:, 0, SPEED], slopes[:, 1, SPEED] = cos * after_s, sin * after_s
    slopes[:, :2, TURN] = slopes[:, :2, HEADING] * (after_s / 2)[:, None]
    slopes[:, HEADING, TURN] = after_s
    return later, slopes


def _process_noise(states: F64, after_s: F64, noise: F64) -> F64:
    """(N, 5, 5) noise of white acceleration along the heading, white yaw acceleration, and model errors.

    A vehicle that stands does not turn; a fast one turns as far as its lateral acceleration allows. Backwards in time
    (`after_s` below 0), errors of position and speed have opposite signs.
    """
    after_s, forth = np.abs(after_s), np.sign(after_s)
    cos, sin = np.cos(states[:, HEADING]), np.sin(states[:, HEADING])
    acceleration, turning, position, heading, rolling_m_s = noise.T
    speeds = np.abs(states[:, SPEED])
    rolls = np.minimum(speeds / np.maximum(rolling_m_s, 1e-9), 1.0)
    max_turning = (LATERAL_M_S2 / np.maximum(speeds, 1e-9)) ** 2
    turning = np.where(rolling_m_s > 0, np.minimum(turning * rolls**2, max_turning), turning)
    along = acceleration * after_s**3 / 3 + position * after_s
    across = position * after_s
    out = np.zeros((len(states), STATE, STATE))
    out[:, 0, 0] = along * cos**2 + across * sin**2
    out[:, 1, 1] = along * sin**2 + across * cos**2
    out[:, 0, 1] = out[:, 1, 0] = (along - across) * cos * sin
    out[:, 0, SPEED] = out[:, SPEED, 0] = forth * acceleration * after_s**2 / 2 * cos
    out[:, 1, SPEED] = out[:, SPEED, 1] = forth * acceleration * after_s**2 / 2 * sin
    out[:, SPEED, SPEED] = acceleration * after_s
    out[:, HEADING, HEADING] = turning * after_s**3 / 3 + heading * after_s
    out[:, HEADING, TURN] = out[:, TURN, HEADING] = forth * turning * after_s**2 / 2
    out[:, TURN, TURN] = turning * after_s
    return out
