"""Tracks estimated from all their sightings at once: class, size, front, and the state in every frame.

The class is that with the largest sum of beliefs. Length and width are quantiles of the boxes', weighted by the number
of points and by how well their covariances say that both ends were seen; a length that nobody saw is as usual among
those of its class that were seen. Each box gets that size, with the side that
the lidars saw kept in place. The front is where the object went; that of a parked object, which has one pose, is the
likelier one by its boxes and the lane beside it.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, Table, first_of_runs
from lidcam.pipeline.fusion.refining.box_prior import CLASS_SIZE_SIGMA, MAX_SIZE_SIGMA
from lidcam.pipeline.tracking.motion import (
    HEADING,
    NO_AXIS_VARIANCE,
    ROBUST_DISTANCE,
    SPEED,
    STATE,
    TURN,
    Motions,
    Priors,
    at_centers,
    at_rear_axles,
    expected,
    innovations,
)
from lidcam.pipeline.tracking.sightings import (
    FORWARD_LOG_ODDS,
    FRONT_PRIOR_VOTES,
    MIN_FRONT_TRAVEL,
    NO_BELIEF,
    SHARED_ERROR,
    WEAK_NOISE,
    Scene,
    Sightings,
    extent_sigmas_m,
    forward_log_odds,
    measurement_covariances,
    shows_part,
    shows_whole,
    size_weights,
)
from lidcam.pipeline.tracking.smoothing import FRAME_CORRELATION, Cells, Courses, smoothed
from lidcam.pipeline.tracking.standing import (
    AXIS_SIGMA_RAD,
    MIN_STANDING_S,
    driven_paths,
    find_parked,
    find_standing,
    lane_directions,
    weighted_quantiles,
)

MIN_LANE_TRAVEL = 3.0
"""Minimum travel, in motion scales, before a track defines a lane; less may be a wrong assignment."""

SIZE_QUANTILE = 0.65
"""Quantile of the weighted lengths and widths; above the median, as other objects hide ends more often than they add to
them."""

MAX_SEEN_SIGMA = 0.06
"""Maximum standard deviation of a length both of whose ends were seen, as a share of it."""

CLASS_COUNT = 1.0
"""Number of vehicles that the length of the class counts as in the usual length of those of a recording."""

MIN_LANE_BELIEF = 0.5
"""Minimum mean probability of a track that defines a lane, over all of its frames: a track that steps from one parked
car to the next is rarely seen."""

LANE_FRONT_LOG_ODDS = 1.5
"""Log odds that a vehicle is parked the way of the lane beside it; in narrow streets many are not."""

MIN_TRAVEL, MAX_TRAVEL_SCATTER = 1.5, 0.08
"""Minimum travel of a track, in motion scales, that only a road user makes, and maximum scatter of its boxes about it,
as a share of it. Posts and bushes that look like people stand, and what else wanders scatters: in KITTI drive 0009 by
a quarter or more of the way, people in simulation by 0.05 at most."""

MIN_TRAVEL_SIGHTINGS = 10
"""Minimum number of sightings of such a travel: any few lie on a smooth path."""

MAX_TRAVEL_SPEED = 2.0
"""Maximum speed of such a travel, in standard deviations of the speed of the class: what is faster is a part of a
vehicle."""

START_WINDOW_S = 0.5
"""Window for the initial velocity, seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """T tracks, ordered by their first sighting."""

    courses: Courses  # First and last frames
    motions: Motions  # (N,) by cell, with positions of the centres
    are_seen: Bools  # (N,) bool, by cell
    sightings: I64  # (N,) by cell, the sighting; -1 where not seen
    standing: Bools  # (N,) bool, by cell
    votes: F64  # (T, C) sums of beliefs by class
    class_ids: I64  # (T,)
    sizes: F64  # (T, 3)
    fronts_known: Bools  # (T,) bool, whether motion shows them
    front_log_odds: F64  # (T,) that the front is where the heading points, by the boxes and the lane
    travelled: Bools  # (T,) bool, whether it went far and smoothly

    def __len__(self) -> int:
        return len(self.class_ids)

    def labels(self, count: int) -> I64:
        """(N,) the track of each of N sightings of the scene; -1 for none."""
        out = np.full(count, -1, np.int64)
        out[self.sightings[self.are_seen]] = self.courses.cell_tracks[self.are_seen]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class _Hits:
    """H sightings that belong to tracks, by track and then by frame."""

    tracks: I64  # (H,)
    rows: Indices  # (H,) row of the scene's sightings
    frames: I64  # (H,)
    firsts: Indices  # (T,) first hit of each track
    lasts: Indices  # (T,) last hit of each track
    sightings: Sightings  # (H,)

    def __len__(self) -> int:
        """Number of tracks."""
        return len(self.firsts)


@dataclass(frozen=True, slots=True, eq=False)
class History(Table):
    """Results about T tracks from an earlier stretch of the recording."""

    ids: I64  # (T,) int64, number of the track; 0 for a new one
    votes: F64  # (T, C) sums of beliefs by class
    sizes: F64  # (T, 3), NaN where unknown
    headings: F64  # (T,) heading in the first frame of the track in this stretch; NaN of a new track
    fronts_known: Bools  # (T,) whether motion showed the front
    front_log_odds: F64  # (T,) that the front is where the heading points
    travelled: Bools  # (T,) whether it went far and smoothly
    log_odds: F64  # (T,) weighted sum of the log odds of its frames
    weights: F64  # (T,) sum of their weights
    firsts_ns: I64  # (T,) int64, time of the first sighting; -1 of a new track

    @classmethod
    def none(cls, count: int, class_count: int) -> Self:
        """New tracks."""
        return cls(
            ids=np.zeros(count, np.int64),
            votes=np.zeros((count, class_count)),
            sizes=np.full((count, 3), np.nan),
            headings=np.full(count, np.nan),
            fronts_known=np.zeros(count, np.bool_),
            front_log_odds=np.zeros(count),
            travelled=np.zeros(count, np.bool_),
            log_odds=np.zeros(count),
            weights=np.zeros(count),
            firsts_ns=np.full(count, -1, np.int64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Pass:
    """A solution for the states of all tracks."""

    courses: Courses  # T tracks
    cells: Cells  # N cells
    cell_of_hit: Indices  # (H,) cell of each hit
    motions: Motions  # (N,) by cell, with positions of the centres


def estimated(scene: Scene, track_of: I64, priors: Priors, history: History | None = None) -> Estimates:
    """Tracks from their sightings.

    The states are solved once freely, which shows how fast objects are, which ones stand, and which way they face. The
    second solution uses that.

    Args:
        scene: N sightings.
        track_of: (N,) track of each, as from `renumbered`; a track has at most one in a frame.
        priors: All classes.
        history: History of the tracks, in their order; None for new tracks.
    """
    hits = _hits(scene, track_of)
    history = History.none(len(hits), len(priors)) if history is None else history
    votes = history.votes.copy()
    np.add.at(votes, (hits.tracks, hits.sightings.class_ids), hits.sightings.beliefs)
    class_ids = votes.argmax(1)
    of_class = priors.select(class_ids)
    noise = FRAME_CORRELATION * measurement_covariances(hits.sightings, priors)
    noise[~of_class.show_axis[hits.tracks], 2, 2] = FRAME_CORRELATION * NO_AXIS_VARIANCE
    are_parts = shows_part(hits.sightings.class_ids, class_ids[hits.tracks], priors)
    noise[are_parts | ~hits.sightings.are_reported] *= WEAK_NOISE

    sizes = _sizes(hits, priors, class_ids, history)
    boxes = _resized_boxes(hits, sizes)
    free = _solved(scene, hits, _initial_courses(scene, hits, boxes, noise, of_class), boxes, noise)
    free, standing = _with_parked(scene, free, of_class)
    noise = _reweighted(hits, free, boxes, noise)
    turned, fronts_known, front_log_odds = _fronts(scene, hits, free, standing, of_class, history)

    courses = _restarted(free, turned, standing, of_class.rear_m(sizes[:, 0]))
    solution = _solved(scene, hits, courses, boxes, noise, standing)
    cells, motions = solution.cells, solution.motions
    sightings = np.full(len(cells), -1, np.int64)
    sightings[solution.cell_of_hit] = hits.rows
    # Smoothing leaves a share of the position error of the last sighting.
    seen_before = np.maximum.accumulate(np.where(cells.are_seen, np.arange(len(cells)), 0))
    motions.covariances[:, :2, :2] += SHARED_ERROR / FRAME_CORRELATION * cells.noise[seen_before, :2, :2]
    return Estimates(
        courses=solution.courses,
        motions=motions,
        are_seen=cells.are_seen,
        sightings=sightings,
        standing=cells.standing,
        votes=votes,
        class_ids=class_ids,
        sizes=sizes,
        fronts_known=fronts_known,
        front_log_odds=front_log_odds,
        travelled=history.travelled | _travelled(scene, hits, solution, boxes, of_class),
    )


def renumbered(track_of: I64) -> I64:
    """(N,) track of each of N sightings, numbered from 0 by their first sightings; -1 stays."""
    rows = np.flatnonzero(track_of >= 0)
    _, first, number = np.unique(track_of[rows], return_index=True, return_inverse=True)
    rank, out = np.empty(len(first), np.int64), np.full(len(track_of), -1, np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    out[rows] = rank[number]
    return out


def _hits(scene: Scene, track_of: I64) -> _Hits:
    rows = np.flatnonzero(track_of >= 0)
    rows = rows[np.argsort(track_of[rows], kind="stable")]
    tracks = track_of[rows]
    firsts = np.flatnonzero(first_of_runs(tracks))
    lasts = np.append(firsts[1:], len(rows))[: len(firsts)] - 1
    return _Hits(tracks, rows, scene.frames[rows], firsts, lasts, scene.sightings.select(rows))


def _sizes(hits: _Hits, priors: Priors, class_ids: I64, history: History) -> F64:
    """(T, 3) sizes by the history, else quantiles of the boxes of its class, and of one that is a little longer.

    Lengths of vehicles are then multiplied by `_usual_shares`.
    """
    sightings, are_solid = hits.sightings, priors.are_solid[class_ids]
    is_whole = shows_whole(sightings.class_ids, class_ids[hits.tracks], priors)
    weights = size_weights(sightings, np.where(is_whole, sightings.beliefs, NO_BELIEF), are_solid[hits.tracks])
    sides, groups = np.where(are_solid, SIZE_QUANTILE, 0.5), (hits.tracks, len(hits))
    shares = sides, sides, np.full(len(hits), 0.5)
    found = [weighted_quantiles(sightings.sizes[:, axis], weights[:, axis], *groups, shares[axis]) for axis in range(3)]
    sizes = np.where(np.isnan(history.sizes), np.stack(found, 1), history.sizes)
    is_new = are_solid & priors.are_alike[class_ids] & np.isnan(history.sizes[:, 0])
    sizes[:, 0] *= np.where(is_new, _usual_shares(hits, sizes[:, 0], is_whole, priors, class_ids), 1.0)
    return sizes


def _usual_shares(hits: _Hits, lengths_m: F64, is_whole: Bools, priors: Priors, class_ids: I64) -> F64:
    """(T,) factors of lengths: what nobody saw of them is as usual in the recording, not in the class.

    Detectors complete boxes to the length of the class, but the cars of a country and of a year differ from it. The
    usual length is the mean of the others that were seen and of the class, by their numbers (empirical Bayes).
    """
    sightings, count = hits.sightings, len(priors)
    sigmas, beliefs = np.full(len(hits), MAX_SIZE_SIGMA), np.zeros(len(hits))
    shares = extent_sigmas_m(sightings)[:, 0] / sightings.sizes[:, 0]
    np.minimum.at(sigmas, hits.tracks, np.where(is_whole & sightings.are_reported, shares, MAX_SIZE_SIGMA))
    np.maximum.at(beliefs, hits.tracks, sightings.beliefs)
    weights = beliefs * (sigmas <= MAX_SEEN_SIGMA)
    excess = weights * (lengths_m / priors.lengths_m[class_ids] - 1)
    others, number = (np.bincount(class_ids, of, count)[class_ids] - of for of in (excess, weights))
    usual = others / (number + CLASS_COUNT)
    return np.asarray(1 + usual * sigmas**2 / (sigmas**2 + CLASS_SIZE_SIGMA**2))


def _resized_boxes(hits: _Hits, sizes: F64) -> F64:
    """(H, 3) boxes with the sizes of their tracks; the sides that the lidars saw stay in place."""
    sightings, boxes = hits.sightings, hits.sightings.boxes.copy()
    shift = sightings.sides * (sightings.sizes[:, :2] - sizes[hits.tracks, :2]) / 2
    cos, sin = np.cos(boxes[:, 2]), np.sin(boxes[:, 2])
    boxes[:, 0] += cos * shift[:, 0] - sin * shift[:, 1]
    boxes[:, 1] += sin * shift[:, 0] + cos * shift[:, 1]
    return boxes


def _initial_courses(scene: Scene, hits: _Hits, boxes: F64, noise: F64, of_class: Priors) -> Courses:
    """Tracks at their first positions, with the velocities over `START_WINDOW_S`."""
    first, count = hits.firsts, len(hits)
    times_s = scene.stamps_s[hits.frames]
    key = hits.tracks * (scene.stamps_s[-1] + 10.0) + times_s
    later = np.minimum(np.searchsorted(key, key[first] + START_WINDOW_S), hits.lasts)
    travel = boxes[later, :2] - boxes[first, :2]
    after_s = np.maximum(times_s[later] - times_s[first], 1e-3)
    distance = np.linalg.norm(travel, axis=1)
    speeds = np.where(later > first, distance / after_s, 0.0)
    headings = boxes[first, 2].copy()
    moves = (distance > MIN_FRONT_TRAVEL * of_class.scales_m) | ~of_class.show_axis
    headings[moves] = np.arctan2(travel[moves, 1], travel[moves, 0])
    backwards = (travel * np.stack([np.cos(headings), np.sin(headings)], 1)).sum(1) < 0
    states, covariances = np.zeros((count, STATE)), np.zeros((count, STATE, STATE))
    states[:, :2], states[:, HEADING] = boxes[first, :2], headings
    states[:, SPEED] = np.where(backwards, -speeds, speeds)
    covariances[:, :2, :2] = 4 * noise[first, :2, :2]
    covariances[:, HEADING, HEADING] = np.where(of_class.show_axis, 0.5**2, 2.0)
    covariances[:, SPEED, SPEED] = of_class.speeds**2
    covariances[:, TURN, TURN] = 0.5**2
    return Courses(
        firsts=hits.frames[hits.firsts],
        lasts=hits.frames[hits.lasts],
        states=states,
        covariances=covariances,
        noise=of_class.noise,
        speeds=of_class.speeds,
        rear_m=np.zeros(count),
    )


def _solved(
    scene: Scene, hits: _Hits, courses: Courses, boxes: F64, noise: F64, standing: Bools | None = None
) -> _Pass:
    """The states by the boxes (H, 3) and their covariances; `standing` (N,) are the cells in which tracks stand."""
    count = int(courses.starts[-1])
    cell_of_hit = courses.starts[hits.tracks] + hits.frames - courses.firsts[hits.tracks]
    cells = Cells(
        are_seen=np.zeros(count, np.bool_),
        boxes=np.zeros((count, 3)),
        noise=np.tile(np.eye(3), (count, 1, 1)),
        later_s=np.zeros(count),
        standing=np.zeros(count, np.bool_) if standing is None else standing,
    )
    cells.are_seen[cell_of_hit], cells.later_s[cell_of_hit] = True, hits.sightings.later_s
    cells.boxes[cell_of_hit], cells.noise[cell_of_hit] = boxes, noise
    motions = smoothed(courses, cells, scene.stamps_s, scene.sites_xy)
    return _Pass(courses, cells, cell_of_hit, at_centers(motions, np.repeat(courses.rear_m, courses.counts)))


def _reweighted(hits: _Hits, solution: _Pass, boxes: F64, noise: F64) -> F64:
    """(H, 3, 3) covariances of the boxes (H, 3), larger for those far beside the solved track."""
    motions = solution.motions.select(solution.cell_of_hit)
    beside, _ = innovations(motions, boxes, hits.sightings.later_s, np.zeros(len(boxes)))
    distances = (beside * np.linalg.solve(noise, beside[..., None])[..., 0]).sum(1)
    return np.asarray(noise * np.maximum(distances / ROBUST_DISTANCE, 1.0)[:, None, None])


def _travelled(scene: Scene, hits: _Hits, solution: _Pass, boxes: F64, of_class: Priors) -> Bools:
    """(T,) whether the boxes (H, 3) of each track follow a path that only a road user takes."""
    path, _ = expected(solution.motions.select(solution.cell_of_hit), hits.sightings.later_s, np.zeros(len(boxes)))
    counts = hits.lasts - hits.firsts + 1
    lasts_s = scene.stamps_s[hits.frames[hits.lasts]] - scene.stamps_s[hits.frames[hits.firsts]]
    scatter_m = np.sqrt(np.bincount(hits.tracks, ((boxes - path)[:, :2] ** 2).sum(1), len(hits)) / counts)
    away_m = np.linalg.norm((path - path[hits.firsts][hits.tracks])[:, :2], axis=1)
    travels_m = np.maximum.reduceat(away_m, hits.firsts)
    is_long = (counts >= MIN_TRAVEL_SIGHTINGS) & (travels_m > MIN_TRAVEL * of_class.scales_m)
    is_possible = travels_m < MAX_TRAVEL_SPEED * of_class.speeds * lasts_s
    return np.asarray(is_long & is_possible & (scatter_m < MAX_TRAVEL_SCATTER * travels_m))


def _with_parked(scene: Scene, free: _Pass, of_class: Priors) -> tuple[_Pass, Bools]:
    """The solution with parked tracks at their places, and the cells (N,) in which tracks stand."""
    courses, motions = free.courses, free.motions
    standing = find_standing(scene.stamps_s, courses, free.cells, motions, of_class)
    standing, poses = find_parked(courses, free.cells, motions, of_class, standing)
    is_parked = np.isfinite(poses[:, HEADING])
    in_parked = is_parked[courses.cell_tracks]
    states, covariances = motions.states.copy(), courses.covariances.copy()
    states[in_parked, : HEADING + 1] = poses[courses.cell_tracks[in_parked]]
    covariances[is_parked, HEADING, HEADING] = AXIS_SIGMA_RAD**2
    courses = replace(courses, covariances=covariances)
    return replace(free, courses=courses, motions=replace(motions, states=states)), standing


def _fronts(
    scene: Scene, hits: _Hits, free: _Pass, standing: Bools, of_class: Priors, history: History
) -> tuple[Bools, Bools, F64]:
    """(T,) which tracks have to be turned round, (T,) which fronts are known then, and (T,) their log odds else."""
    courses, motions = free.courses, free.motions
    tracks, frames = courses.cell_tracks, courses.cell_frames
    after_s = np.diff(scene.stamps_s, prepend=0.0)[frames]
    after_s[standing] = after_s[courses.starts[:-1]] = 0.0
    along_m = np.bincount(tracks, motions.states[:, SPEED] * after_s, len(courses))
    agrees = np.cos(hits.sightings.boxes[:, 2] - motions.states[free.cell_of_hit, HEADING]) > 0
    votes = hits.sightings.beliefs * hits.sightings.show_front / FRAME_CORRELATION
    votes_for, votes_against = (np.bincount(hits.tracks, votes * side, len(courses)) for side in (agrees, ~agrees))
    log_odds = np.log((votes_for + FRONT_PRIOR_VOTES) / (votes_against + FRONT_PRIOR_VOTES))
    first = motions.states[courses.starts[:-1], : HEADING + 1]
    stays = (np.abs(along_m) < MIN_FRONT_TRAVEL * of_class.scales_m) & of_class.show_axis
    parked = np.flatnonzero(stays & of_class.are_solid)
    lasts_s = scene.stamps_s[courses.lasts] - scene.stamps_s[courses.firsts]
    drives = (np.abs(along_m) > MIN_LANE_TRAVEL * of_class.scales_m) & of_class.show_axis & (lasts_s > MIN_STANDING_S)
    drives &= np.bincount(hits.tracks, hits.sightings.beliefs, len(courses)) > MIN_LANE_BELIEF * courses.counts
    paths = driven_paths(motions.select(drives[tracks]), scene.sites_xy, scene.stamps_s)
    lanes = lane_directions(first[parked], of_class.scales_m[parked], paths)
    log_odds[parked] += LANE_FRONT_LOG_ODDS * np.nan_to_num(np.sign(np.cos(lanes - first[parked, HEADING])))
    before = np.sign(np.cos(first[:, HEADING] - np.nan_to_num(history.headings)))
    log_odds += before * history.front_log_odds
    # A car may reverse out of a parking space: over a short way, its boxes may outweigh the motion.
    moved = np.where(stays, 0.0, forward_log_odds(np.asarray(along_m, np.float64), of_class.scales_m))
    shown = moved + np.where(stays | (of_class.are_solid & of_class.show_axis), log_odds, 0.0)
    turned = np.where(history.fronts_known, before < 0, shown < 0)
    is_far = np.abs(along_m) > MIN_FRONT_TRAVEL * of_class.scales_m
    known = history.fronts_known | (is_far & (np.abs(shown) > FORWARD_LOG_ODDS))
    return turned, known, np.where(turned, -log_odds, log_odds)


def _restarted(solution: _Pass, turned: Bools, standing: Bools, rear_m: F64) -> Courses:
    """The tracks again from their solved first states, now of the rear axles; `turned` (T,) are turned round."""
    courses, motions, first = solution.courses, solution.motions, solution.courses.starts[:-1]
    states, covariances = motions.states[first].copy(), courses.covariances.copy()
    states[turned, HEADING] += np.pi
    states[turned, SPEED] *= -1
    states[standing[first], SPEED:] = 0.0
    states = at_rear_axles(Motions(states, covariances), rear_m).states
    covariances[:, HEADING, HEADING] = np.minimum(covariances[:, HEADING, HEADING], 0.5**2)
    return replace(courses, states=states, covariances=covariances, rear_m=rear_m)
