"""Tracks estimated from all their sightings at once: class, size, front, and where they were at every moment.

One class, by the beliefs of all sightings. One rigid size: the median of the boxes, each side counting as much as it
faced the lidars; the length of vehicles from how far their points reach, over all frames. Each box gets that size, with
the side that the lidars saw in its place. The front is where the object went. What stands has one pose.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, Table, first_of_runs, join_rows
from lidcam.pipeline.tracking.lanes import driven_paths, lane_directions
from lidcam.pipeline.tracking.motion import (
    HEADING,
    SPEED,
    STATE,
    TURN,
    Motions,
    Priors,
    at_centers,
    at_rear_axles,
)
from lidcam.pipeline.tracking.quantiles import quantiles
from lidcam.pipeline.tracking.sightings import ALIKE, FRONT_SHARE, SHARED_ERROR, FrameSightings, Sightings, measured
from lidcam.pipeline.tracking.smoothing import Cells, Courses, smoothed
from lidcam.pipeline.tracking.standing import AXIS_RAD, STANDING_S, find_parked, find_standing

JUMP_SHARE = 0.03
"""As in `lidcam.pipeline.tracking.online`; less, as the size of a track is settled."""

DRIVEN_SHARE = 3.0
"""What came so many lengths far shows the direction of a lane; less may be a wrong assignment."""

LENGTH_QUANTILE = 0.95
"""The length is this quantile of the distances between the ends of single frames."""

ENDS_LEAST, SIDEWAYS, LENGTH_LEAST_SHARE = 5, 0.25, 0.6
"""Number of frames with both ends from which on the length is taken from them; how much a lidar has to look from the
side; what is shorter than this share of the class's length was seen in part."""

START_S = 0.5
"""The first velocity of a track is that of so long."""

NO_AXIS_VARIANCE = 400.0
"""Variance of the yaw of boxes that show no axis, rad^2: they say nothing of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The sightings of a stretch of frames.

    Attributes:
        stamps_ns: (F,) int64, times of the frames.
        stamps_s: (F,) the same since the first of them.
        sites_xy: (F, 2) where the rig was.
        sightings: N of them, frame by frame.
        frames: (N,) frame of each.
        starts: (F + 1,) first sighting of each frame, and N.
    """

    stamps_ns: I64
    stamps_s: F64
    sites_xy: F64
    sightings: Sightings
    frames: I64
    starts: I64

    @classmethod
    def of(cls, frames: list[FrameSightings]) -> Self:
        """The scene of one frame or more, whose stamps rise."""
        counts = np.array([len(frame.sightings) for frame in frames])
        stamps_ns = np.array([frame.stamp_ns for frame in frames], np.int64)
        return cls(
            stamps_ns,
            (stamps_ns - stamps_ns[0]) / 1e9,
            np.array([frame.T_fixed_site[:2, 3] for frame in frames]),
            join_rows(*[frame.sightings for frame in frames]),
            np.repeat(np.arange(len(frames)), counts),
            np.concatenate([[0], np.cumsum(counts)]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """T tracks, ordered by their first sighting.

    Attributes:
        courses: Their first and last frames.
        motions: Cell by cell, the places those of the centres.
        are_seen: (N,) bool, by cell.
        sightings: (N,) by cell, the sighting; -1 where not seen.
        stand: (N,) bool, by cell.
        votes: (T, C) sums of beliefs by class.
        class_ids: (T,).
        sizes: (T, 3).
        fronts_known: (T,) bool.
    """

    courses: Courses
    motions: Motions
    are_seen: Bools
    sightings: I64
    stand: Bools
    votes: F64
    class_ids: I64
    sizes: F64
    fronts_known: Bools

    def __len__(self) -> int:
        return len(self.class_ids)

    def labels(self, count: int) -> I64:
        """(N,) the track of each of N sightings of the scene; -1 for none."""
        out = np.full(count, -1, np.int64)
        out[self.sightings[self.are_seen]] = self.courses.cell_tracks[self.are_seen]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class _Hits:
    """H sightings that belong to tracks, by track and then by frame.

    Attributes:
        tracks: (H,).
        rows: (H,) row of the scene's sightings.
        frames: (H,).
        starts: (T,) first hit of each track.
        lasts: (T,) last hit of each track.
        sightings: (H,).
    """

    tracks: I64
    rows: Indices
    frames: I64
    starts: Indices
    lasts: Indices
    sightings: Sightings


@dataclass(frozen=True, slots=True, eq=False)
class Known(Table):
    """What an earlier stretch of the recording has told of T tracks.

    Attributes:
        ids: (T,) int64, number of the track; 0 for a new one.
        votes: (T, C) sums of beliefs by class.
        sizes: (T, 3), NaN where unknown.
        headings: (T,) heading in the first frame of the track in this stretch; NaN where the front is not known.
        log_odds: (T,) sum of the log odds of its frames.
        counts: (T,) int64, number of frames.
        firsts_ns: (T,) int64, when it was first seen; -1 of a new one.
    """

    ids: I64
    votes: F64
    sizes: F64
    headings: F64
    log_odds: F64
    counts: I64
    firsts_ns: I64

    @classmethod
    def nothing(cls, count: int, class_count: int) -> Self:
        """New tracks."""
        return cls(
            np.zeros(count, np.int64),
            np.zeros((count, class_count)),
            np.full((count, 3), np.nan),
            np.full(count, np.nan),
            np.zeros(count),
            np.zeros(count, np.int64),
            np.full(count, -1, np.int64),
        )


def estimated(scene: Scene, track_of: I64, priors: Priors, known: Known | None = None) -> Estimates:
    """Tracks from their sightings.

    Args:
        scene: N sightings.
        track_of: (N,) track of each, -1 for none; a track has at most one in a frame. Numbers may have gaps: tracks
            are ordered by their first sighting.
        priors: Of all classes.
        known: What is known of the tracks, in their order; with it, the sizes are refined by the ends of the objects.
    """
    hits = _hits(scene, track_of)
    count = len(hits.starts)
    is_last = known is not None
    known = Known.nothing(count, len(priors)) if known is None else known
    votes = known.votes.copy()
    np.add.at(votes, (hits.tracks, hits.sightings.class_ids), hits.sightings.beliefs)
    class_ids = votes.argmax(1)
    of_class = priors.select(class_ids)
    sizes = np.where(np.isnan(known.sizes), _median_sizes(hits, class_ids), known.sizes)
    _, noise = measured(hits.sightings, priors, JUMP_SHARE)
    noise = ALIKE * noise
    noise[~of_class.have_axis[hits.tracks], 2, 2] = NO_AXIS_VARIANCE
    boxes = _resized(hits, sizes)
    courses = _courses(scene, hits, boxes, noise, of_class)
    cells, rows = _cells(courses, hits, boxes, noise)
    motions = smoothed(courses, cells, scene.stamps_s)
    stand = find_standing(scene.stamps_s, courses, cells, motions, of_class)
    stand, axes = find_parked(courses, cells, motions, of_class, stand)
    has_axis = np.isfinite(axes)[courses.cell_tracks]
    motions.states[has_axis, HEADING] = axes[courses.cell_tracks[has_axis]]
    courses.covariances[np.isfinite(axes), HEADING, HEADING] = AXIS_RAD**2
    turned, fronts_known = _fronts(scene, hits, courses, motions, stand, of_class, known, rows)
    for refines in (False, True) if is_last else (False,):
        if refines:
            sizes = np.where(np.isnan(known.sizes), _lengths(hits, rows, motions, sizes, of_class), known.sizes)
            boxes = _resized(hits, sizes)
        courses = _restarted(courses, motions, turned, stand, of_class.rear_m(sizes[:, 0]))
        turned = np.zeros_like(turned)
        cells, rows = _cells(courses, hits, boxes, noise, stand)
        motions = smoothed(courses, cells, scene.stamps_s)
        motions = at_centers(motions, np.repeat(courses.rear_m, courses.counts))
    sightings = np.full(len(cells), -1, np.int64)
    sightings[rows] = hits.rows
    motions.covariances[:, :2, :2] += _shared_errors(cells)
    return Estimates(courses, motions, cells.are_seen, sightings, cells.stand, votes, class_ids, sizes, fronts_known)


def renumbered(track_of: I64) -> I64:
    """(N,) track of each of N sightings, numbered from 0 by their first sightings; -1 stays."""
    rows = np.flatnonzero(track_of >= 0)
    _, first, number = np.unique(track_of[rows], return_index=True, return_inverse=True)
    rank, out = np.empty(len(first), np.int64), np.full(len(track_of), -1, np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    out[rows] = rank[number]
    return out


def _hits(scene: Scene, track_of: I64) -> _Hits:
    track_of = renumbered(track_of)
    rows = np.flatnonzero(track_of >= 0)
    tracks = track_of[rows]
    order = np.argsort(tracks, kind="stable")
    rows, tracks = rows[order], tracks[order]
    starts = np.flatnonzero(first_of_runs(tracks)) if len(rows) else np.zeros(0, np.intp)
    lasts = np.append(starts[1:], len(rows))[: len(starts)] - 1
    return _Hits(tracks, rows, scene.frames[rows], starts, lasts, scene.sightings.select(rows))


def _median_sizes(hits: _Hits, class_ids: I64) -> F64:
    """(T, 3) medians of the sizes of boxes of the track's class, each side by how well the lidars saw it."""
    of_hit, count = hits.sightings, len(hits.starts)
    weights = np.where(of_hit.class_ids == class_ids[hits.tracks], of_hit.beliefs, 1e-9)
    sides = of_hit.faces * weights[:, None]
    columns = [
        quantiles(of_hit.sizes[:, axis], weight, hits.tracks, count, 0.5)
        for axis, weight in enumerate((sides[:, 0], sides[:, 1], sides.sum(1)))
    ]
    return np.stack(columns, 1)


def _resized(hits: _Hits, sizes: F64) -> F64:
    """(H, 3) boxes of the sizes of their tracks; the sides that the lidars saw stay where they are."""
    of_hit, boxes = hits.sightings, hits.sightings.boxes.copy()
    shift = of_hit.sides * (of_hit.sizes[:, :2] - sizes[hits.tracks, :2]) / 2
    cos, sin = np.cos(boxes[:, 2]), np.sin(boxes[:, 2])
    boxes[:, 0] += cos * shift[:, 0] - sin * shift[:, 1]
    boxes[:, 1] += sin * shift[:, 0] + cos * shift[:, 1]
    return boxes


def _courses(scene: Scene, hits: _Hits, boxes: F64, noise: F64, of_class: Priors) -> Courses:
    """Tracks as they begin: with the first place, and the velocity of the first half second."""
    first, count = hits.starts, len(hits.starts)
    times_s = scene.stamps_s[hits.frames]
    key = hits.tracks * (scene.stamps_s[-1] + 10.0) + times_s
    later = np.minimum(np.searchsorted(key, key[first] + START_S), hits.lasts)
    away = boxes[later, :2] - boxes[first, :2]
    after_s = np.maximum(times_s[later] - times_s[first], 1e-3)
    distance = np.linalg.norm(away, axis=1)
    speeds = np.where(later > first, distance / after_s, 0.0)
    headings = boxes[first, 2].copy()
    goes = (distance > FRONT_SHARE * of_class.units_m) | ~of_class.have_axis
    headings[goes] = np.arctan2(away[goes, 1], away[goes, 0])
    backwards = (away * np.stack([np.cos(headings), np.sin(headings)], 1)).sum(1) < 0
    states, covariances = np.zeros((count, STATE)), np.zeros((count, STATE, STATE))
    states[:, :2], states[:, HEADING] = boxes[first, :2], headings
    states[:, SPEED] = np.where(backwards, -speeds, speeds)
    covariances[:, :2, :2] = 4 * noise[first, :2, :2]
    covariances[:, HEADING, HEADING] = np.where(of_class.have_axis, 0.5**2, 2.0)
    covariances[:, SPEED, SPEED] = of_class.speeds**2
    covariances[:, TURN, TURN] = 0.5**2
    firsts, lasts = hits.frames[hits.starts], hits.frames[hits.lasts]
    return Courses(firsts, lasts, states, covariances, of_class.noise, of_class.speeds, np.zeros(count))


def _cells(courses: Courses, hits: _Hits, boxes: F64, noise: F64, stand: Bools | None = None) -> tuple[Cells, Indices]:
    """What is measured of tracks, and the cell of each sighting."""
    count = int(courses.starts[-1])
    rows = courses.starts[hits.tracks] + hits.frames - courses.firsts[hits.tracks]
    are_seen = np.zeros(count, np.bool_)
    measured_boxes, covariances, later_s = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1)), np.zeros(count)
    are_seen[rows], measured_boxes[rows], covariances[rows] = True, boxes, noise
    later_s[rows] = hits.sightings.later_s
    stand = np.zeros(count, np.bool_) if stand is None else stand
    return Cells(are_seen, measured_boxes, covariances, later_s, stand), rows


def _fronts(
    scene: Scene,
    hits: _Hits,
    courses: Courses,
    motions: Motions,
    stand: Bools,
    of_class: Priors,
    known: Known,
    rows: Indices,
) -> tuple[Bools, Bools]:
    """(T,) which tracks have to be turned round, and (T,) of which the front is known then."""
    tracks, frames = courses.cell_tracks, courses.cell_frames
    after_s = np.diff(scene.stamps_s, prepend=0.0)[frames]
    after_s[stand] = after_s[courses.starts[:-1]] = 0.0
    count = len(courses)
    along_m = np.bincount(tracks, motions.states[:, SPEED] * after_s, count)
    agreeing = np.cos(hits.sightings.boxes[:, 2] - motions.states[rows, HEADING])
    most = np.bincount(hits.tracks, hits.sightings.beliefs * np.sign(agreeing), count)
    first = motions.states[courses.starts[:-1], : HEADING + 1]
    stands = (np.abs(along_m) < FRONT_SHARE * of_class.units_m) & of_class.have_axis
    vehicles = np.flatnonzero(stands & of_class.are_solid)
    lasts_s = scene.stamps_s[courses.lasts] - scene.stamps_s[courses.firsts]
    drives = (np.abs(along_m) > DRIVEN_SHARE * of_class.units_m) & of_class.have_axis & (lasts_s > STANDING_S)
    paths = driven_paths(motions.select(drives[tracks]), scene.sites_xy, scene.stamps_s)
    lanes = lane_directions(first[vehicles], of_class.units_m[vehicles], paths)
    most[vehicles] = np.where(np.isfinite(lanes), np.cos(lanes - first[vehicles, HEADING]), most[vehicles])
    turned = np.where(stands, most < 0, along_m < 0)
    was_known = np.isfinite(known.headings)
    against = np.cos(first[:, HEADING] - known.headings) < 0
    turned = np.where(was_known, against, turned)
    return turned, was_known | (np.abs(along_m) > FRONT_SHARE * of_class.units_m)


def _restarted(courses: Courses, motions: Motions, turned: Bools, stand: Bools, rear_m: F64) -> Courses:
    """The tracks once more from the place where they were found to begin, now of the rear axle."""
    first = courses.starts[:-1]
    states, covariances = motions.states[first].copy(), courses.covariances.copy()
    states[turned, HEADING] += np.pi
    states[turned, SPEED] *= -1
    states[stand[first], SPEED:] = 0.0
    states = at_rear_axles(Motions(states, covariances), rear_m).states
    covariances[:, HEADING, HEADING] = np.minimum(covariances[:, HEADING, HEADING], 0.5**2)
    return Courses(courses.firsts, courses.lasts, states, covariances, courses.noise, courses.speeds, rear_m)


def _lengths(hits: _Hits, rows: Indices, motions: Motions, sizes: F64, of_class: Priors) -> F64:
    """Sizes (T, 3) whose length is how far apart the ends of the objects are, where both were seen often enough."""
    states = motions.states[rows]
    ends, cos, sin = hits.sightings.ends, np.cos(states[:, HEADING]), np.sin(states[:, HEADING])
    away = ends[..., :2] - states[:, None, :2]
    along = away[..., 0] * cos[:, None] + away[..., 1] * sin[:, None] - states[:, None, SPEED] * ends[..., 2]
    extents = np.abs(along[:, 0] - along[:, 1])
    faces = hits.sightings.faces
    sideways = faces[:, 0] / np.hypot(faces[:, 0], faces[:, 1])
    usable = np.isfinite(extents) & (sideways > SIDEWAYS) & of_class.are_solid[hits.tracks]
    weights = np.where(usable, sideways * hits.sightings.point_counts, 0.0)
    count = len(sizes)
    found = quantiles(np.nan_to_num(extents), weights, hits.tracks, count, LENGTH_QUANTILE)
    enough = np.bincount(hits.tracks, usable, count) >= ENDS_LEAST
    enough &= found > LENGTH_LEAST_SHARE * of_class.lengths_m
    out = sizes.copy()
    out[enough, 0] = found[enough]
    return out


def _shared_errors(cells: Cells) -> F64:
    """(N, 2, 2) error of each cell's place that smoothing leaves: a share of that of its last sighting."""
    seen_before = np.maximum.accumulate(np.where(cells.are_seen, np.arange(len(cells)), 0))
    return SHARED_ERROR / ALIKE * cells.noise[seen_before, :2, :2]
