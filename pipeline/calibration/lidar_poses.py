"""Poses by which all lidars see the same surfaces: a graph of poses, whose edges are the errors between two lidars.

Errors between lidars do not tell which of them is off. The recorded poses do: each is off by a small error, few by a
large one (Student's t distribution). So two lidars with a small error meet in the middle, and of several the one that
is far from the others is moved. Rotations come first: else those of a wide rig would be turned to explain one that
stands elsewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.calibration.lidar_error import SIGNIFICANT_SIGMAS, LidarError, lidar_error
from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.geometry.rotations import pose_matrix, turned
from lidcam.pipeline.core.rig import LidarSensor

ROTATION_SIGMA_RAD = np.radians(0.3)
"""Standard deviation of each recorded rotation but for the tails, radians."""

TRANSLATION_SIGMA_M = 0.02
"""Standard deviation of each recorded translation but for the tails, metres."""

FREEDOM = 4.0
"""Degrees of freedom of Student's t distribution of the errors of a recorded pose: few are far off."""

FIXED_WEIGHT = 1e12
"""Weight of a pose that is right by definition."""

START_WEIGHT = 1e-3
"""Weight of the poses that may be off at a start."""

FURTHER = 1.5
"""Minimum ratio of the motions of two lidars, in standard deviations, for the one that moves further to be wrong.

Small errors between two lidars are halved, and of three lidars the wrong one moves twice as far as the others."""

STEPS = 20
"""Number of steps with new weights."""


@dataclass(frozen=True, slots=True)
class LidarPair:
    """Two lidars and the error between them."""

    first: LidarSensor
    second: LidarSensor
    error: LidarError | None  # The error of the second against the first; None if they show too little
    is_first_off: bool = False  # Whether the first is clearly moved further than the second so that they agree


class ComparedLidars(NamedTuple):
    """How well the lidars of a rig agree."""

    pairs: tuple[LidarPair, ...]  # Any two of them, as recorded
    agreeing: tuple[LidarSensor, ...]  # All lidars, moved so that they agree; empty where no error is significant


NOT_COMPARED = ComparedLidars((), ())


def compared_lidars(lidars: Sequence[LidarSensor], site_frame: str, clouds: Sequence[Sequence[F64]]) -> ComparedLidars:
    """How well lidars agree, and the poses by which they do.

    Args:
        lidars: As recorded.
        site_frame: The only lidar whose frame this is stays where it is.
        clouds: For some frames, points (N, 3) of each lidar in the site frame, metres.
    """
    pairs = [
        _compared(lidars[first], lidars[second], [(found[first], found[second]) for found in clouds])
        for first, second in combinations(range(len(lidars)), 2)
    ]
    if not any(pair.error is not None and pair.error.significant.any() for pair in pairs):
        return ComparedLidars(tuple(pairs), ())
    motions = agreeing_motions(lidars, site_frame, pairs)
    sigmas = [ROTATION_SIGMA_RAD] * 3 + [TRANSLATION_SIGMA_M] * 3
    size = {lidar.name: float(np.linalg.norm(one / sigmas)) for lidar, one in zip(lidars, motions, strict=True)}
    pairs = [replace(one, is_first_off=size[one.first.name] > FURTHER * size[one.second.name]) for one in pairs]
    return ComparedLidars(tuple(pairs), tuple(map(moved_lidar, lidars, motions)))


def agreeing_motions(lidars: Sequence[LidarSensor], site_frame: str, pairs: Sequence[LidarPair]) -> F64:
    """(L, 6) the motions that make lidars agree, as in `LidarError`; zeros for a lidar in no pair with an error.

    Args:
        lidars: As recorded.
        site_frame: The only lidar whose frame this is stays where it is.
        pairs: Any two of them at most once.
    """
    row_of = {lidar.name: row for row, lidar in enumerate(lidars)}
    judged = [(pair, pair.error) for pair in pairs if pair.error is not None]
    names = [(row_of[pair.first.name], row_of[pair.second.name]) for pair, _ in judged]
    rows = np.array(names, np.int64).reshape(-1, 2)
    values = np.array([error.values for _, error in judged]).reshape(-1, 6)
    covariances = np.array([error.covariance for _, error in judged]).reshape(-1, 6, 6)
    places = np.array([lidar.T_site_lidar.translation for lidar in lidars])
    fixed = [row for row, lidar in enumerate(lidars) if lidar.T_site_lidar.src == site_frame]
    fixed = fixed if len(fixed) == 1 else []  # of several, drivers have put all clouds into this frame
    first, second = rows.T
    turns = _shared(rows, values[:, :3], covariances[:, :3, :3], ROTATION_SIGMA_RAD, len(lidars), fixed)
    # The translation that is left once the rotations are known; the second is carried by the rotation of the first.
    gains = covariances[:, 3:, :3] @ np.linalg.inv(covariances[:, :3, :3])
    shifts = values[:, 3:] + np.einsum("pij,pj->pi", gains, turns[second] - turns[first] - values[:, :3])
    shifts += np.cross(turns[first], places[second] - places[first])
    left = covariances[:, 3:, 3:] - gains @ covariances[:, :3, 3:]
    return np.concatenate([turns, _shared(rows, shifts, left, TRANSLATION_SIGMA_M, len(lidars), fixed)], 1)


def moved_lidar(lidar: LidarSensor, values: F64) -> LidarSensor:
    """The lidar, turned about itself and moved along the axes of the site frame by `values` (6,)."""
    pose = lidar.T_site_lidar
    matrix = pose_matrix(turned(values[:3]) @ pose.matrix[:3, :3], pose.translation + values[3:])
    return replace(lidar, T_site_lidar=replace(pose, matrix=matrix))


def _compared(first: LidarSensor, second: LidarSensor, frames: Sequence[tuple[F64, F64]]) -> LidarPair:
    """Two lidars; without an error if that is not alike in all frames, as where one or the rig moves unnoticed."""
    places = first.T_site_lidar.translation, second.T_site_lidar.translation
    estimate = partial(lidar_error, reference_site=places[0], origin_site=places[1])
    error = estimate(frames)
    if error is not None and error.significant.any() and len(frames) > 1:
        for one in filter(None, (estimate([frame]) for frame in frames)):
            distances = np.abs(one.values - error.values) / np.hypot(one.sigmas, error.sigmas)
            if (distances[error.significant] > SIGNIFICANT_SIGMAS).any():
                return LidarPair(first, second, None)
    return LidarPair(first, second, error)


def _shared(rows: I64, values: F64, covariances: F64, sigma: float, count: int, fixed: Sequence[int]) -> F64:
    """(L, 3) the vectors of L lidars whose differences are as measured, as likely as possible.

    Pairs `rows` (P, 2) of lidars have measured differences `values` (P, 3) of the second and the first, with
    `covariances` (P, 3, 3). The vectors have the standard deviation `sigma`, but for the tails; those of `fixed` are 0.
    """
    slopes = np.zeros((len(rows), count))
    slopes[np.arange(len(rows)), rows[:, 0]], slopes[np.arange(len(rows)), rows[:, 1]] = -1.0, 1.0
    weighted = np.einsum("pk,pij->pkij", slopes, np.linalg.inv(covariances))
    information = np.einsum("pkij,pl->kilj", weighted, slopes).reshape(3 * count, 3 * count)
    pull = np.einsum("pkij,pj->ki", weighted, values).ravel()
    found: list[tuple[float, int, F64]] = []
    for start in range(count):
        weights = np.where(np.arange(count) == start, 1.0, START_WEIGHT)
        for _ in range(STEPS):
            weights[fixed] = FIXED_WEIGHT
            vectors = np.linalg.solve(information + np.diag(weights.repeat(3)) / sigma**2, pull).reshape(count, 3)
            squares = (vectors**2).sum(1) / sigma**2
            weights = (FREEDOM + 3) / (FREEDOM + squares)
        unlikely = (FREEDOM + 3) * np.log1p(squares / FREEDOM).sum()
        cost = vectors.ravel() @ (information @ vectors.ravel() - 2 * pull) + unlikely
        found.append((round(float(cost), 6), start, np.asarray(vectors)))  # of equal ones, the first lidar is believed
    return min(found)[2]
