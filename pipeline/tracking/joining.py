"""Joins tracks of one object: over a gap without sightings, and in one place at one time."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Indices
from lidcam.pipeline.core.geometry.overlaps import OVERLAP_SHARE
from lidcam.pipeline.core.geometry.rotated_iou import BoxArrays, shared_ground
from lidcam.pipeline.fusion.assignment import assign
from lidcam.pipeline.tracking.estimates import Estimates
from lidcam.pipeline.tracking.motion import HEADING, SPEED, Motions, Priors, predicted

MAX_DISTANCE = 16.0
"""Maximum squared Mahalanobis distance of position and velocity, halfway, between two tracks that are joined."""

MAX_COST = 24.0
"""Maximum cost of joining two tracks."""

EXTRA_SIGMA = 0.05
"""Standard deviation added to positions and velocities, as a share of the class length."""

OTHER_CLASS_COST = 4.0
"""Cost of different classes."""

GAP_COST = 2.0
"""Cost of a gap, per second."""

MIN_REACH = 0.2
"""Minimum speed of a track in its reach over a gap, in class lengths per second."""


def joined_over_gaps(estimates: Estimates, stamps_s: F64, priors: Priors, max_gap_s: float) -> I64:
    """(T,) number of the track that each of T tracks belongs to; equal numbers are one track.

    Both tracks are predicted to the middle of the gap, and all pairs are found in one assignment.
    """
    courses, out = estimates.courses, np.arange(len(estimates))
    first, second = _within_reach(estimates, stamps_s, priors.lengths_m[estimates.class_ids], max_gap_s)
    gap_s = stamps_s[courses.firsts[second]] - stamps_s[courses.lasts[first]]
    ends = estimates.motions.select((courses.starts[1:] - 1)[first])
    begins = estimates.motions.select(courses.starts[:-1][second])
    of_class = priors.select(estimates.class_ids[first])
    before, _ = predicted(ends, gap_s / 2, of_class.noise)
    after, _ = predicted(begins, -gap_s / 2, of_class.noise)
    (here, here_spread), (there, there_spread) = _velocities(before), _velocities(after)
    difference, spread = here - there, here_spread + there_spread
    spread += np.eye(4) * ((EXTRA_SIGMA * of_class.lengths_m) ** 2)[:, None, None]
    distance = (difference * np.linalg.solve(spread, difference[..., None])[..., 0]).sum(1)
    speeds = np.maximum(np.abs(ends.states[:, SPEED]), np.abs(begins.states[:, SPEED]))
    speeds = np.maximum(speeds, MIN_REACH * of_class.lengths_m)
    reachable = np.linalg.norm(difference[:, :2], axis=1) <= of_class.lengths_m + 0.5 * gap_s * speeds
    size = np.log(np.linalg.det(spread[:, :2, :2])) - 4 * np.log(0.1 * of_class.lengths_m)
    differs = estimates.class_ids[first] != estimates.class_ids[second]
    costs = distance + OTHER_CLASS_COST * differs + GAP_COST * gap_s + size
    fits = (distance <= MAX_DISTANCE) & reachable & (costs < MAX_COST)
    earlier, row_of = np.unique(first[fits], return_inverse=True)
    later, column_of = np.unique(second[fits], return_inverse=True)
    matrix = np.zeros((len(earlier), len(later)))
    matrix[row_of, column_of] = costs[fits] - MAX_COST
    rows, columns = assign(matrix)
    paired = matrix[rows, columns] < 0
    # Tracks are in the order of their first sighting, so the earlier one already has its number.
    for row, column in sorted(
        zip(earlier[rows[paired]].tolist(), later[columns[paired]].tolist(), strict=True), key=lambda pair: pair[1]
    ):
        out[column] = out[row]
    return out


def _within_reach(estimates: Estimates, stamps_s: F64, lengths_m: F64, max_gap_s: float) -> tuple[Indices, Indices]:
    """Pairs of tracks, the second of which begins after the end of the first, where `joined_over_gaps` may join them.

    Of all pairs in time, which doubtful tracks make by millions, few are near enough.
    """
    courses, states = estimates.courses, estimates.motions.states
    begins, ends = states[courses.starts[:-1]], states[courses.starts[1:] - 1]
    begins_s, ends_s = stamps_s[courses.firsts], stamps_s[courses.lasts]  # the former rise
    slowest = np.maximum(np.abs(ends[:, SPEED]), MIN_REACH * lengths_m)
    seconds = []
    for track, after in enumerate(np.searchsorted(begins_s, ends_s, side="right").tolist()):
        gaps_s = begins_s[after:] - ends_s[track]
        gaps_s = gaps_s[gaps_s <= max_gap_s]
        near = begins[after : after + len(gaps_s)]
        away_m = np.hypot(*(near[:, :2] - ends[track, :2]).T)
        reach_m = lengths_m[track] + 1.5 * gaps_s * np.maximum(slowest[track], np.abs(near[:, SPEED]))
        seconds.append(after + np.flatnonzero(away_m <= reach_m))
    return np.repeat(np.arange(len(seconds)), list(map(len, seconds))), np.concatenate([np.zeros(0, np.intp), *seconds])


def _velocities(motions: Motions) -> tuple[F64, F64]:
    """(N, 4) x, y and velocity along both, and their covariances; independent of the choice of the front."""
    states = motions.states
    cos, sin, speeds = np.cos(states[:, HEADING]), np.sin(states[:, HEADING]), states[:, SPEED]
    slopes = np.zeros((len(states), 4, 5))
    slopes[:, 0, 0] = slopes[:, 1, 1] = 1.0
    slopes[:, 2, HEADING], slopes[:, 2, SPEED] = -speeds * sin, cos
    slopes[:, 3, HEADING], slopes[:, 3, SPEED] = speeds * cos, sin
    positions = np.column_stack([states[:, :2], speeds * cos, speeds * sin])
    return positions, slopes @ motions.covariances @ slopes.swapaxes(1, 2)


def joined_in_place(estimates: Estimates) -> I64:
    """(T,) as `joined_over_gaps`, for tracks on the same ground: one object with two classes, or in two parts.

    A track joins that one of the surer ones with which it shares most ground. It does not join two others: both may
    pass where a doubtful one is for a moment.
    """
    courses, out = estimates.courses, np.arange(len(estimates))
    stays = np.zeros(len(out), np.bool_)
    positions, starts = estimates.motions.states[:, :2], courses.starts[:-1]
    reach = np.hypot(estimates.sizes[:, 0], estimates.sizes[:, 1])[:, None] / 2
    low, high = np.minimum.reduceat(positions, starts) - reach, np.maximum.reduceat(positions, starts) + reach
    for one in np.argsort(-estimates.votes.sum(1), kind="stable").tolist():
        overlaps = (courses.firsts <= courses.lasts[one]) & (courses.firsts[one] <= courses.lasts)
        near = np.flatnonzero(stays & overlaps & (low <= high[one]).all(1) & (low[one] <= high).all(1))
        shares = [_shared(estimates, one, other) for other in near.tolist()]
        if max(shares, default=0.0) > OVERLAP_SHARE:
            out[one] = near[np.argmax(shares)]
        else:
            stays[one] = True
    return out


def _shared(estimates: Estimates, one: int, other: int) -> float:
    """Mean shared ground of two tracks in their common frames, as a share of the smaller box."""
    courses = estimates.courses
    first = max(courses.firsts[one], courses.firsts[other])
    last = min(courses.lasts[one], courses.lasts[other])
    count, boxes = last - first + 1, []
    for track in (one, other):
        start = courses.starts[track] + first - courses.firsts[track]
        states = estimates.motions.states[start : start + count]
        centers = np.column_stack([states[:, :2], np.zeros(count)])
        boxes.append(BoxArrays(centers, np.tile(estimates.sizes[track], (count, 1)), states[:, HEADING]))
    return float(np.mean(shared_ground(*boxes)) / estimates.sizes[[one, other], :2].prod(1).min())
