"""What stands: when, and which way."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools, first_of_runs
from lidcam.pipeline.tracking.motion import SPEED, Motions, Priors
from lidcam.pipeline.tracking.quantiles import quantiles
from lidcam.pipeline.tracking.sightings import ALIKE
from lidcam.pipeline.tracking.smoothing import Cells, Courses

SLOW_SHARE, STANDING_S, STAYS_SHARE = 0.08, 1.0, 0.12
"""What stands: slower than this share of its length a second, for so long, and stays within this share of it."""

SPREAD_SHARE, SIGNIFICANT = 0.1, 3.0
"""What stands all the time comes no farther than this share of its length, or than so many standard deviations of that
by the scatter of its places."""

CREEPS_SHARE, SWAYS = 0.3, 2.0
"""Faster than this share of its length a second it drives, however its places scatter; and where they scatter by more
than so many times the difference between neighbouring frames, it drives there and back."""

MOSTLY, TURNED_RAD, AXIS_RAD = 0.5, np.radians(20), 0.1
"""What stands for more than this share of its frames stands in all, unless a box that is turned from its axis by less
than this shows it elsewhere; standard deviation of that axis."""

ELSEWHERE_SHARE = 0.3
"""What is farther than this share of its length from where it stands is elsewhere."""


def find_standing(stamps_s: F64, courses: Courses, cells: Cells, motions: Motions, of_class: Priors) -> Bools:
    """(N,) the cells in which a track stands: slow for a second and in one place, or all the time."""
    tracks, frames = courses.cell_tracks, courses.cell_frames
    places, units_m = motions.states[:, :2], of_class.units_m[tracks]
    sigma = np.sqrt(motions.covariances[:, SPEED, SPEED])
    slow = np.abs(motions.states[:, SPEED]) < np.maximum(SLOW_SHARE * units_m, np.minimum(2 * sigma, 0.12 * units_m))
    run = np.cumsum(first_of_runs(tracks) | first_of_runs(slow)) - 1
    begins = np.flatnonzero(first_of_runs(run))
    ends = np.append(begins[1:], len(run)) - 1
    lasting = stamps_s[frames[ends]] - stamps_s[frames[begins]] >= STANDING_S
    stays = np.linalg.norm(places[ends] - places[begins], axis=1) < STAYS_SHARE * units_m[begins]
    stand = slow & (lasting & stays)[run]
    return np.asarray(stand | _stays(stamps_s, courses, cells, of_class)[tracks])


def _stays(stamps_s: F64, courses: Courses, cells: Cells, of_class: Priors) -> Bools:
    """(T,) tracks whose measured places show no motion beyond their scatter, by a line through them over time."""
    rows = np.flatnonzero(cells.are_seen)
    tracks, count = courses.cell_tracks[rows], len(courses)
    weights = 1 / np.trace(cells.noise[rows, :2, :2], axis1=1, axis2=2)
    total = np.bincount(tracks, weights, count)

    def mean(values: F64) -> F64:
        return np.stack([np.bincount(tracks, weights * column, count) / total for column in values.T], 1)

    at_s = stamps_s[courses.cell_frames[rows], None]
    at_s = at_s - mean(at_s)[tracks]
    away = cells.boxes[rows, :2] - mean(cells.boxes[rows, :2])[tracks]
    spread_s2 = np.maximum(mean(at_s**2), 1e-9)
    velocities = mean(at_s * away) / spread_s2
    rest = away - velocities[tracks] * at_s
    scatter = np.sqrt(mean(rest**2).sum(1))
    follows = ~first_of_runs(tracks)[1:]
    steps2 = np.bincount(tracks[1:][follows], (np.diff(rest, axis=0)[follows] ** 2).sum(1), count)
    hits = np.bincount(tracks, minlength=count)
    jitter = np.sqrt(steps2 / 2 / np.maximum(hits - 1, 1))
    lasts_s = stamps_s[courses.lasts] - stamps_s[courses.firsts]
    speeds, sigma = np.hypot(*velocities.T), scatter * np.sqrt(ALIKE / hits / spread_s2[:, 0])
    near_m = SPREAD_SHARE * of_class.units_m
    return np.asarray(
        (speeds * lasts_s < np.maximum(near_m, SIGNIFICANT * sigma * lasts_s))
        & (speeds < CREEPS_SHARE * of_class.units_m)
        & (scatter < np.maximum(near_m / 2, SWAYS * jitter))
        & of_class.have_axis
        & (lasts_s >= STANDING_S / 2)
    )


def find_parked(courses: Courses, cells: Cells, motions: Motions, of_class: Priors, stand: Bools) -> tuple[Bools, F64]:
    """The cells (N,) in which a track stands, and (T,) axes of those that stand in all of theirs; NaN of the others.

    What stands most of the time stands all the time, unless boxes along its axis show it elsewhere: far away, boxes of
    few points are turned and moved about.
    """
    tracks, count = courses.cell_tracks, len(courses)
    places, units_m = motions.states[:, :2], of_class.units_m[tracks]
    mostly = (np.bincount(tracks, stand, count) > MOSTLY * courses.counts) & of_class.have_axis
    stood = [quantiles(places[:, axis], stand.astype(np.float64), tracks, count, 0.5) for axis in (0, 1)]
    away = np.linalg.norm(cells.boxes[:, :2] - np.stack(stood, 1)[tracks], axis=1)
    weights = np.where(cells.are_seen & stand, 1 / cells.noise[:, 2, 2], 0.0)
    cos, sin = (np.bincount(tracks, weights * of(2 * cells.boxes[:, 2]), count) for of in (np.cos, np.sin))
    axes = np.arctan2(sin, cos) / 2
    along = np.abs(np.sin(cells.boxes[:, 2] - axes[tracks])) < np.sin(TURNED_RAD)
    elsewhere = np.bincount(tracks, cells.are_seen & along & (away > ELSEWHERE_SHARE * units_m), count)
    stand = stand | (mostly & (elsewhere == 0))[tracks]
    whole = (np.bincount(tracks, ~stand, count) == 0) & of_class.have_axis
    return stand, np.where(whole, axes, np.nan)
