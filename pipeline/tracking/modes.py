"""Tracks that stand or move: a filter for each, which exchange what they know.

Most vehicles are parked, and a filter that knows motion alone gives them the speed of their noise. Each mode is as
probable as the boxes that it expects (interacting multiple models: Blom and Bar-Shalom, IEEE Transactions on Automatic
Control 33(8), 1988).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, Table
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.tracking.motion import (
    HEADING,
    ROBUST_DISTANCE,
    SPEED,
    Motions,
    innovations,
    predicted,
    updated,
    with_known_axes,
    with_possible_turns,
)
from lidcam.pipeline.tracking.smoothing import FRAME_CORRELATION

MODE_S = 10.0
"""Mean time until a standing object moves, and until a moving one stands, seconds."""

MAX_MODE_DISTANCE = 50.0
"""Maximum squared Mahalanobis distance of a box that counts against a mode."""

_STANDING = np.array([0.0, 0.0, 1.0, 1.0, 1.0])  # a standing object does not accelerate


@dataclass(frozen=True, slots=True, eq=False)
class Modes(Table):
    """N tracks as they would be if they stood, and if they moved, and the probability (N,) that they move."""

    standing: Motions
    moving: Motions
    moves: F64

    @classmethod
    def of_new(cls, standing: Motions, moving: Motions) -> Self:
        """Tracks that stand or move, which is as likely."""
        standing = _stopped(standing)
        standing.covariances[:] *= FRAME_CORRELATION
        return cls(standing, moving, np.full(len(moving), 0.5))

    def combined(self) -> Motions:
        """Means and covariances over both modes."""
        return _mixed(self.standing, self.moving, self.moves)

    def speed_spreads(self) -> F64:
        """(N,) standard deviations of the speeds between the two modes, m/s."""
        return np.asarray(np.sqrt(self.moves * (1 - self.moves)) * np.abs(self.moving.states[:, SPEED]))

    def in_both(self, change: Callable[[Motions], Motions]) -> Self:
        """The tracks with a change of the motions in either mode."""
        return replace(self, standing=change(self.standing), moving=change(self.moving))

    def predicted(self, after_s: float, noise: F64) -> Self:
        """The tracks some seconds later; `noise` (N, 5) is that of `Priors`."""
        changes = 0.5 * (1 - np.exp(-2 * after_s / MODE_S))
        moves = self.moves * (1 - changes) + (1 - self.moves) * changes
        standing = _mixed(self.standing, self.moving, self.moves * changes / (1 - moves))
        moving = _mixed(self.standing, self.moving, self.moves * (1 - changes) / moves)
        return replace(
            self,
            standing=predicted(_stopped(standing), after_s, noise * _STANDING)[0],
            moving=predicted(moving, after_s, noise)[0],
            moves=moves,
        )

    def updated(self, boxes: F64, later_s: F64, rear_m: F64, box_noise: F64, rolling_m_s: F64) -> Self:
        """The tracks after a box (N, 3) each, of covariance (N, 3, 3), measured some seconds (N,) after the states."""
        log_odds = np.log(self.moves) - np.log1p(-self.moves)
        beside_moving, _ = innovations(self.moving, boxes, later_s, rear_m)
        box_noise = with_known_axes(box_noise, beside_moving, self.moving, rolling_m_s)
        after = []
        for sign, motions, correlation in ((-1, self.standing, FRAME_CORRELATION), (1, self.moving, 1.0)):
            difference, slopes = innovations(motions, boxes, later_s, rear_m)
            spread = slopes @ motions.covariances @ slopes.swapaxes(1, 2) + box_noise
            distance = (difference * np.linalg.solve(spread, difference[..., None])[..., 0]).sum(1)
            log_odds -= sign / 2 * (np.minimum(distance, MAX_MODE_DISTANCE) + np.linalg.slogdet(spread)[1])
            after.append(updated(motions, difference, slopes, correlation * box_noise, ROBUST_DISTANCE))
        moves = 1 / (1 + np.exp(-np.clip(log_odds, -20, 20)))
        return replace(
            self, standing=_stopped(after[0]), moving=with_possible_turns(after[1], rolling_m_s), moves=moves
        )


def _stopped(motions: Motions) -> Motions:
    """The same motions without speed and yaw rate."""
    states, covariances = motions.states.copy(), motions.covariances.copy()
    states[:, SPEED:] = 0
    covariances[:, SPEED:] = covariances[:, :, SPEED:] = 0
    return Motions(states, covariances)


def _mixed(first: Motions, second: Motions, share: F64) -> Motions:
    """Means and covariances of two motions of each track, with a share (N,) of the second."""
    difference = second.states - first.states
    difference[:, HEADING] = wrap_angle(difference[:, HEADING])
    share = share[:, None]
    between = (1 - share) * difference
    apart = (share * between)[:, :, None] * difference[:, None]
    covariances = first.covariances + share[..., None] * (second.covariances - first.covariances) + apart
    return Motions(first.states + share * difference, covariances)
