"""Standing objects: when they stand, along which axis, and the direction of the lane beside them.

Most vehicles are parked the way that others drive past them.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, first_of_runs
from lidcam.pipeline.tracking.motion import HEADING, SPEED, Motions, Priors
from lidcam.pipeline.tracking.smoothing import FRAME_CORRELATION, Cells, Courses

MAX_STANDING_SPEED = 0.08
"""Maximum speed of a standing object, in motion scales per second."""

MIN_STANDING_S = 1.0
"""Minimum duration of a stop, seconds."""

MAX_STOP_TRAVEL = 0.12
"""Maximum displacement over a stop, in motion scales."""

MAX_STATIC_TRAVEL = 0.1
"""Maximum displacement of a static track, in motion scales."""

MAX_STATIC_SIGMAS = 3.0
"""Maximum displacement of a static track, in its standard deviations by the scatter of the positions."""

MAX_STATIC_SPEED = 0.3
"""Maximum speed of a static track, in motion scales per second, however its positions scatter."""

MAX_SWAY = 2.0
"""Maximum scatter of a static track, in differences between neighbouring frames; beyond, it drives there and back."""

MIN_PARKED_SHARE = 0.5
"""Minimum share of what is known of a track's places, by their variances, that shows it standing throughout."""

MAX_AXIS_TURN_RAD = np.radians(20)
"""Maximum turn of a box against the axis of a parked object to count as evidence that it moved, radians."""

AXIS_SIGMA_RAD = 0.1
"""Standard deviation of the axis of a parked object, radians."""

MIN_MOVED_DISTANCE = 0.3
"""Minimum distance from its parking position at which an object has moved, in motion scales, beyond its deviation."""

MIN_LANE_SPEED = 0.5
"""Minimum speed of traffic that defines a lane, in lengths of the parked object per second; slower may be parking."""

MIN_LANE_DISTANCE = 0.4
"""Minimum distance of a lane from the middle of a parked object, in its lengths."""

MAX_LANE_TURN_RAD = np.radians(20)
"""Maximum angle between a lane and the parked object beside it, radians."""


def find_standing(stamps_s: F64, courses: Courses, cells: Cells, motions: Motions, of_class: Priors) -> Bools:
    """(N,) the cells in which a track stands: slow for a second and in one place, or all the time."""
    tracks, frames = courses.cell_tracks, courses.cell_frames
    positions, scales_m = motions.states[:, :2], of_class.scales_m[tracks]
    sigma = np.sqrt(motions.covariances[:, SPEED, SPEED])
    max_speed = np.maximum(MAX_STANDING_SPEED * scales_m, np.minimum(2 * sigma, 0.12 * scales_m))
    is_slow = np.abs(motions.states[:, SPEED]) < max_speed
    run = np.cumsum(first_of_runs(tracks) | first_of_runs(is_slow)) - 1
    firsts = np.flatnonzero(first_of_runs(run))
    lasts = np.append(firsts[1:], len(run)) - 1
    is_long = stamps_s[frames[lasts]] - stamps_s[frames[firsts]] >= MIN_STANDING_S
    stays = np.linalg.norm(positions[lasts] - positions[firsts], axis=1) < MAX_STOP_TRAVEL * scales_m[firsts]
    standing = is_slow & (is_long & stays)[run]
    return np.asarray(standing | _are_static(stamps_s, courses, cells, of_class)[tracks])


def _are_static(stamps_s: F64, courses: Courses, cells: Cells, of_class: Priors) -> Bools:
    """(T,) tracks whose measured positions show no motion beyond their scatter, by a line through them over time."""
    rows = np.flatnonzero(cells.are_seen)
    tracks, count = courses.cell_tracks[rows], len(courses)
    weights = 1 / np.trace(cells.noise[rows, :2, :2], axis1=1, axis2=2)
    total = np.bincount(tracks, weights, count)

    def mean(values: F64) -> F64:
        return np.stack([np.bincount(tracks, weights * column, count) / total for column in values.T], 1)

    at_s = stamps_s[courses.cell_frames[rows], None]
    at_s = at_s - mean(at_s)[tracks]
    offsets = cells.boxes[rows, :2] - mean(cells.boxes[rows, :2])[tracks]
    spread_s2 = np.maximum(mean(at_s**2), 1e-9)
    velocities = mean(at_s * offsets) / spread_s2
    residuals = offsets - velocities[tracks] * at_s
    scatter = np.sqrt(mean(residuals**2).sum(1))
    follows = ~first_of_runs(tracks)[1:]
    steps2 = np.bincount(tracks[1:][follows], (np.diff(residuals, axis=0)[follows] ** 2).sum(1), count)
    hits = np.bincount(tracks, minlength=count)
    jitter = np.sqrt(steps2 / 2 / np.maximum(hits - 1, 1))
    lasts_s = stamps_s[courses.lasts] - stamps_s[courses.firsts]
    speeds, sigma = np.hypot(*velocities.T), scatter * np.sqrt(FRAME_CORRELATION / hits / spread_s2[:, 0])
    max_travel_m = MAX_STATIC_TRAVEL * of_class.scales_m
    return np.asarray(
        (speeds * lasts_s < np.maximum(max_travel_m, MAX_STATIC_SIGMAS * sigma * lasts_s))
        & (speeds < MAX_STATIC_SPEED * of_class.scales_m)
        & (scatter < np.maximum(max_travel_m / 2, MAX_SWAY * jitter))
        & of_class.show_axis
        & (lasts_s >= MIN_STANDING_S / 2)
    )


def find_parked(
    courses: Courses, cells: Cells, motions: Motions, of_class: Priors, standing: Bools
) -> tuple[Bools, F64]:
    """The cells (N,) in which a track stands, and x, y, axis (T, 3) of those that stand in all of theirs, else NaN.

    A track that stands in most frames is parked throughout, unless boxes along its axis show it elsewhere: far away,
    boxes of few points are turned and displaced.
    """
    tracks, count = courses.cell_tracks, len(courses)
    xy, scales_m = motions.states[:, :2], of_class.scales_m[tracks]
    variances = np.trace(cells.noise[:, :2, :2], axis1=1, axis2=2)
    weights = cells.are_seen / variances
    mostly = np.bincount(tracks, weights * standing, count) > MIN_PARKED_SHARE * np.bincount(tracks, weights, count)
    places = [weighted_quantiles(xy[:, axis], standing.astype(np.float64), tracks, count, 0.5) for axis in (0, 1)]
    distances = np.linalg.norm(cells.boxes[:, :2] - np.stack(places, 1)[tracks], axis=1)
    weights = np.where(cells.are_seen & standing, 1 / cells.noise[:, 2, 2], 0.0)
    cos, sin = (np.bincount(tracks, weights * of(2 * cells.boxes[:, 2]), count) for of in (np.cos, np.sin))
    axes = np.arctan2(sin, cos) / 2
    along = np.abs(np.sin(cells.boxes[:, 2] - axes[tracks])) < np.sin(MAX_AXIS_TURN_RAD)
    is_away = distances > MIN_MOVED_DISTANCE * scales_m + np.sqrt(variances)
    moved = np.bincount(tracks, cells.are_seen & along & is_away, count)
    standing = standing | (mostly & (moved == 0) & of_class.show_axis)[tracks]
    throughout = (np.bincount(tracks, ~standing, count) == 0) & of_class.show_axis
    return standing, np.where(throughout[:, None], np.column_stack([*places, axes]), np.nan)


def driven_paths(motions: Motions, sites_xy: F64, stamps_s: F64) -> F64:
    """(M, 4) x, y, direction and speed of moving tracks and of the rig.

    Args:
        motions: Tracks at some moments.
        sites_xy: (F, 2) positions of the rig.
        stamps_s: (F,) their times, not falling.
    """
    states = motions.states
    backwards = np.pi * (states[:, SPEED] < 0)
    paths = np.column_stack([states[:, :2], states[:, HEADING] + backwards, np.abs(states[:, SPEED])])
    rises = np.diff(stamps_s, prepend=-np.inf) > 0
    sites_xy, stamps_s = sites_xy[rises], stamps_s[rises]
    if len(stamps_s) < 2:
        return paths
    x_m_s, y_m_s = np.gradient(sites_xy, stamps_s, axis=0).T
    of_rig = np.column_stack([sites_xy, np.arctan2(y_m_s, x_m_s), np.hypot(x_m_s, y_m_s)])
    return np.concatenate([paths, of_rig])


def lane_directions(standing: F64, lengths_m: F64, paths: F64) -> F64:
    """(T,) direction of the nearest path past each standing object, parallel to it; NaN where there is none.

    Args:
        standing: (T, 3) x, y and heading of the objects, the heading modulo half a turn.
        lengths_m: (T,) their lengths; a lane beyond this distance may run the other way.
        paths: (M, 4) as from `driven_paths`.
    """
    out = np.full(len(standing), np.nan)
    for row, ((x, y, heading), length_m) in enumerate(zip(standing, lengths_m, strict=True)):
        distances_m = np.hypot(paths[:, 0] - x, paths[:, 1] - y)
        is_beside = (distances_m > MIN_LANE_DISTANCE * length_m) & (distances_m < length_m)
        is_beside &= np.abs(np.sin(paths[:, 2] - heading)) < np.sin(MAX_LANE_TURN_RAD)
        is_beside &= paths[:, 3] > MIN_LANE_SPEED * length_m
        if is_beside.any():
            out[row] = paths[np.where(is_beside, distances_m, np.inf).argmin(), 2]
    return out


def weighted_quantiles(values: F64, weights: F64, groups: I64, count: int, share: float | F64) -> F64:
    """(G,) weighted quantile of the values (N,) of each group, at one share or (G,); NaN of a group without weight."""
    order = np.lexsort((values, groups))
    values, weights, groups = values[order], weights[order], groups[order]
    total = np.bincount(groups, weights, count)
    starts = np.searchsorted(groups, np.arange(count))
    sums = np.cumsum(weights)
    before = np.concatenate([[0.0], sums])[starts]
    reached = sums - before[groups] >= (share * total)[groups] * (1 - 1e-12)
    found = np.full(count, np.nan)
    first = np.flatnonzero(reached & (total[groups] > 0))[::-1]
    found[groups[first]] = values[first]
    return found
