"""Tracks with knowledge of the future: a recording is solved in windows that overlap by some seconds.

Association comes first, over the whole window; then each track is estimated from its sightings. Tracks in one place
are joined, and tracks over gaps. A track that is too improbable as a whole is left out: frames are not independent, so
the mean of its log odds counts, not their sum, and those frames most that could show it best.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, first_of_runs, replace_rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.detectors.log_odds import logit
from lidcam.pipeline.fusion.belief.odds import probability
from lidcam.pipeline.tracking.estimates import Estimates, History, estimated, renumbered
from lidcam.pipeline.tracking.joining import joined_in_place, joined_over_gaps
from lidcam.pipeline.tracking.motion import HEADING, SPEED, Priors
from lidcam.pipeline.tracking.online import MAX_UNSEEN_S, OnlineTracker
from lidcam.pipeline.tracking.sightings import MIN_MEASUREMENTS, NOT_SEEN, FrameSightings, Scene, TrackRows
from lidcam.pipeline.tracking.undersides import climb_variances, road_heights, smoothed_undersides, underside_variances

EXTRA_OVERLAP_S = 2.0
"""Extra window overlap beyond `max_gap_s`, seconds."""

MAX_USUAL_STEPS = 3.0
"""Maximum time between frames over which they are associated, in medians, if that is longer than `MAX_UNSEEN_S`."""

MISS_LOG_ODDS = -2.0
"""Log odds of a frame that does not show a track, shortly before or after a sighting."""

MISS_MARGIN_S = 0.25
"""Time before and after a sighting in which misses count, seconds; later, the object may be hidden."""

MAX_MISS_STEP_S = 0.75
"""Maximum time from a sighting to the next frame in which a miss counts, seconds, where frames are rare."""

TRAVEL_LOG_ODDS = 2.5
"""Log odds added to those of people who travel: things that look like people to the lidars hardly ever do."""

PLAIN_POINTS = 200.0
"""Number of lidar points with half the weight of any number: a view of few points is a poorer view of the same thing,
which says nothing that a better one does not."""


class OfflineTracker:
    """Tracks of frames that come in order, returned when they are settled."""

    def __init__(self, priors: Priors, *, min_existence: float, window_s: float, max_gap_s: float) -> None:
        self._priors, self._min_existence = priors, min_existence
        self._window_ns, self._max_gap_s = round(window_s * 1e9), max_gap_s
        self._overlap_ns = round((max_gap_s + EXTRA_OVERLAP_S) * 1e9)
        self._frames: list[FrameSightings] = []
        self._settled_count = 0  # frames at the front of them that were returned already
        self._next_id = 1
        self._history = History.none(0, len(priors))
        self._settled_ids = np.zeros(0, np.int64)  # track of each sighting of the settled frames

    def add_frame(self, frame: FrameSightings) -> list[TrackRows]:
        """Add the next frame; the rows of the oldest waiting frames that are settled."""
        out = self.finish() if self._frames and frame.stamp_ns < self._frames[-1].stamp_ns else []
        self._frames.append(frame)
        waiting_ns = frame.stamp_ns - self._frames[min(self._settled_count, len(self._frames) - 1)].stamp_ns
        if waiting_ns < self._window_ns + self._overlap_ns:
            return out
        stamps_ns = np.array([one.stamp_ns for one in self._frames])
        return out + self._solved(int(np.searchsorted(stamps_ns, frame.stamp_ns - self._overlap_ns, side="right")))

    def finish(self) -> list[TrackRows]:
        """The rows of all waiting frames; later frames have new tracks."""
        out = self._solved(len(self._frames)) if self._settled_count < len(self._frames) else []
        self._frames, self._settled_count, self._settled_ids = [], 0, np.zeros(0, np.int64)
        self._history = History.none(0, len(self._priors))
        return out

    def _solved(self, until: int) -> list[TrackRows]:
        """The rows of the frames from the first waiting one to `until`."""
        first = self._settled_count
        scene = Scene.of(self._frames)
        labels = self._associated(scene)
        if (labels < 0).all():
            self._keep(scene, np.zeros(len(labels), np.int64), until)
            self._history = History.none(0, len(self._priors))
            return [TrackRows.none()] * (until - first)
        estimates, history = self._estimated(scene, labels)
        over_gaps = partial(joined_over_gaps, stamps_s=scene.stamps_s, priors=self._priors, max_gap_s=self._max_gap_s)
        for join in (joined_in_place, over_gaps, joined_in_place):
            merged = join(estimates)
            if len(np.unique(merged)) < len(merged):
                estimates, history = self._estimated(scene, _relabelled(scene, estimates, merged))
        existence = probability(self._existence(scene, estimates, history))
        kept = existence >= self._min_existence
        new = kept & (history.ids == 0) & (estimates.courses.firsts < until)  # others are solved again
        history.ids[new] = np.arange(self._next_id, self._next_id + new.sum())
        self._next_id += int(new.sum())
        rows = _rows(scene, estimates, history, self._priors, existence, kept)
        self._carry(scene, estimates, history, kept, until)
        return rows[first:until]

    def _estimated(self, scene: Scene, labels: I64) -> tuple[Estimates, History]:
        """Tracks by the label of each sighting, and their history."""
        labels = renumbered(labels)
        history = self._history_of(labels)
        return estimated(scene, labels, self._priors, history), history

    def _associated(self, scene: Scene) -> I64:
        """(N,) track of each sighting, frame by frame; -1 for none. Over missing frames, tracks are joined later."""
        usual_s = float(np.median(np.diff(scene.stamps_s))) if len(self._frames) > 1 else 0.0
        max_gap_s = min(max(MAX_UNSEEN_S, MAX_USUAL_STEPS * usual_s), self._max_gap_s)
        tracker = OnlineTracker(self._priors, min_existence=0.0, max_gap_s=max_gap_s)
        labels = np.full(len(scene.frames), -1, np.int64)
        begins = scene.sightings.are_reported.copy()
        # What belongs to a track begins it in this window, too, which may show nothing surer of it.
        begins[: len(self._settled_ids)] |= self._settled_ids > 0
        frames = [*zip(self._frames, pairwise(scene.starts.tolist()), strict=True)]
        for frame, (first, last) in frames:
            sightings = replace(frame.sightings, are_reported=begins[first:last])
            tracker.add_frame(replace(frame, sightings=sightings))
            ids = tracker.ids_of_sightings
            labels[first:last] = np.where(ids > 0, ids, -1)
        self._add_beginnings(frames, labels, max_gap_s)
        return labels

    def _add_beginnings(
        self, frames: Sequence[tuple[FrameSightings, tuple[int, int]]], labels: I64, max_gap_s: float
    ) -> None:
        """Label the improbable sightings before the first probable one of a track, backwards in time.

        Forwards, they only continue a track. `frames` are those of `labels` (N,), with the bounds of their sightings.
        """
        tracker = OnlineTracker(self._priors, min_existence=0.0, max_gap_s=max_gap_s)
        is_first, label_of = np.zeros(len(labels), np.bool_), dict[int, int]()
        is_first[np.unique(labels, return_index=True)[1]] = True
        for frame, (first, last) in reversed(frames):
            now = labels[first:last]
            sightings = replace(frame.sightings, are_reported=now >= 0, later_s=-frame.sightings.later_s)
            tracker.add_frame(replace(frame, stamp_ns=-frame.stamp_ns, sightings=sightings))
            ids = tracker.ids_of_sightings
            begin = is_first[first:last] & (now >= 0)
            label_of.update(zip(ids[begin].tolist(), now[begin].tolist(), strict=True))
            unnamed = np.flatnonzero(now < 0)
            now[unnamed] = [label_of.get(number, -1) for number in ids[unnamed].tolist()]

    def _existence(self, scene: Scene, estimates: Estimates, history: History) -> F64:
        """(T,) weighted mean log odds of existence, and more for people who travel.

        How likely the speed of a new track is counts as one frame more.
        """
        tracks, count = estimates.courses.cell_tracks, len(estimates)
        log_odds, weights = _evidence(scene, estimates)
        stamps_s, courses = scene.stamps_s, estimates.courses
        steps_s = np.diff(stamps_s, prepend=-np.inf, append=np.inf)
        begins = np.searchsorted(stamps_s, stamps_s[courses.firsts] - MISS_MARGIN_S)
        begins = np.minimum(begins, courses.firsts - (steps_s[courses.firsts] <= MAX_MISS_STEP_S))
        ends = np.searchsorted(stamps_s, stamps_s[courses.lasts] + MISS_MARGIN_S, side="right") - 1
        ends = np.maximum(ends, courses.lasts + (steps_s[courses.lasts + 1] <= MAX_MISS_STEP_S))
        first = courses.starts[:-1]
        first_weights = np.where(history.ids > 0, 0.0, weights[first])
        missed = (courses.firsts - begins) * first_weights + (ends - courses.lasts) * weights[courses.starts[1:] - 1]
        by_speed = -((estimates.motions.states[first, SPEED] / courses.speeds) ** 2) / 2
        total = history.log_odds + np.bincount(tracks, weights * log_odds, count)
        total += missed * MISS_LOG_ODDS + first_weights * by_speed
        mean = total / (history.weights + np.bincount(tracks, weights, count) + missed + first_weights)
        are_people = ~self._priors.are_solid[estimates.class_ids]
        return np.asarray(mean + TRAVEL_LOG_ODDS * (are_people & estimates.travelled))

    def _history_of(self, labels: I64) -> History:
        """The history of each track: that of the earlier track with which it has most sightings in common.

        Args:
            labels: (N,) track of each sighting, numbered by their first sightings; -1 for none.
        """
        count = int(labels.max()) + 1
        before = self._settled_ids
        now = labels[: len(before)]
        both = (before > 0) & (now >= 0)
        pairs, common = np.unique(np.stack([now[both], before[both]], 1), axis=0, return_counts=True)
        row_of = {number: row for row, number in enumerate(self._history.ids.tolist())}
        rows = np.full(count, -1)
        for track, number in pairs[np.argsort(-common, kind="stable")].tolist():
            if rows[track] < 0 and number in row_of:
                rows[track] = row_of.pop(number)
        found = np.flatnonzero(rows >= 0)
        return replace_rows(History.none(count, len(self._priors)), found, self._history.select(rows[found]))

    def _carry(self, scene: Scene, estimates: Estimates, history: History, kept: Bools, until: int) -> None:
        """Keep the frames with which the next window begins, and the history of their tracks."""
        numbers, labels = np.where(kept, history.ids, 0), estimates.labels(len(scene.frames))
        keep_from = self._keep(scene, np.where(labels >= 0, numbers[labels], 0), until)
        courses = estimates.courses
        tracks, count = courses.cell_tracks, len(estimates)
        is_older = courses.cell_frames < keep_from
        seen = np.flatnonzero(estimates.are_seen & is_older)
        sightings = scene.sightings.select(estimates.sightings[seen])
        votes = history.votes.copy()
        np.add.at(votes, (tracks[seen], sightings.class_ids), sightings.beliefs)
        log_odds, weights = _evidence(scene, estimates)
        weights[~is_older] = 0.0
        begin = np.maximum(courses.firsts, keep_from)
        at = np.minimum(courses.starts[:-1] + begin - courses.firsts, courses.starts[1:] - 1)
        continues = np.flatnonzero(kept & (courses.lasts >= keep_from))
        self._history = History(
            ids=history.ids,
            votes=votes,
            sizes=estimates.sizes,
            headings=estimates.motions.states[at, HEADING],
            fronts_known=estimates.fronts_known,
            front_log_odds=estimates.front_log_odds,
            travelled=estimates.travelled,
            log_odds=history.log_odds + np.bincount(tracks, weights * log_odds, count),
            weights=history.weights + np.bincount(tracks, weights, count),
            firsts_ns=np.where(history.firsts_ns >= 0, history.firsts_ns, scene.stamps_ns[courses.firsts]),
        ).select(continues)

    def _keep(self, scene: Scene, ids: I64, until: int) -> int:
        """Drop the frames before the overlap with the next window; the first frame of the overlap.

        Args:
            scene: The frames.
            ids: (N,) number of the track of each sighting, 0 for none.
            until: First frame that is not settled.
        """
        last_ns = scene.stamps_ns[min(until, len(self._frames) - 1)]
        keep_from = int(np.searchsorted(scene.stamps_ns, last_ns - self._overlap_ns))
        self._settled_ids = ids[scene.starts[keep_from] : scene.starts[until]]
        self._frames, self._settled_count = self._frames[keep_from:], until - keep_from
        return keep_from


def _evidence(scene: Scene, estimates: Estimates) -> tuple[F64, F64]:
    """(N,) log odds of each cell by its sighting, or by a miss, and (N,) its weight by how well it could be seen."""
    seen = np.flatnonzero(estimates.are_seen)
    rows, cells = estimates.sightings[seen], np.arange(len(estimates.are_seen))
    log_odds = np.full(len(cells), MISS_LOG_ODDS)
    log_odds[seen] = logit(scene.sightings.beliefs[rows])
    points = np.interp(cells, seen, np.maximum(scene.sightings.point_counts[rows], 1))
    stamps_s = scene.stamps_s[estimates.courses.cell_frames]
    before, after = seen[np.searchsorted(seen, cells, side="right") - 1], seen[np.searchsorted(seen, cells)]
    after_s = np.minimum(stamps_s - stamps_s[before], stamps_s[after] - stamps_s)
    is_next = np.minimum(cells - before, after - cells) <= 1
    counts = after_s <= np.where(is_next, MAX_MISS_STEP_S, MISS_MARGIN_S)
    return log_odds, counts * points / (points + PLAIN_POINTS)


def _relabelled(scene: Scene, estimates: Estimates, merged: I64) -> I64:
    """(N,) track of each sighting after joining.

    While the surest of the joined tracks lasts, the others' sightings are left out: they show parts of its object.
    """
    courses, labels = estimates.courses, estimates.labels(len(scene.frames))
    by_votes = np.lexsort((-estimates.votes.sum(1), merged))
    surest = by_votes[np.searchsorted(merged[by_votes], merged)]
    rows = np.flatnonzero(labels >= 0)
    main, frames = surest[labels[rows]], scene.frames[rows]
    rows = rows[(labels[rows] == main) | (frames < courses.firsts[main]) | (frames > courses.lasts[main])]
    tracks, frames = merged[labels[rows]], scene.frames[rows]
    order = np.lexsort((rows, -scene.sightings.beliefs[rows], frames, tracks))
    chosen = order[first_of_runs(tracks[order] * len(scene.stamps_s) + frames[order])]
    out = np.full(len(scene.frames), -1, np.int64)
    out[rows[chosen]] = tracks[chosen]
    return out


def _rows(
    scene: Scene, estimates: Estimates, history: History, priors: Priors, existence: F64, kept: Bools
) -> list[TrackRows]:
    """The rows of each frame."""
    courses = estimates.courses
    tracks, frames = courses.cell_tracks, courses.cell_frames
    cells = np.flatnonzero(kept[tracks])
    cells = cells[np.lexsort((history.ids[tracks[cells]], frames[cells]))]
    tracks, frames = tracks[cells], frames[cells]
    states = estimates.motions.states[cells]
    states[:, HEADING] = wrap_angle(states[:, HEADING])
    first_ns = np.where(history.firsts_ns >= 0, history.firsts_ns, scene.stamps_ns[courses.firsts])
    sightings = estimates.sightings[cells]
    counts = np.bincount(courses.cell_tracks, estimates.are_seen, len(estimates))
    is_measured = (counts >= MIN_MEASUREMENTS) | (history.firsts_ns >= 0)  # those were seen in earlier windows, too
    is_possible = np.abs(states[:, SPEED]) <= priors.max_speeds[estimates.class_ids[tracks]]
    rows = TrackRows(
        ids=history.ids[tracks],
        states=states,
        covariances=estimates.motions.covariances[cells],
        rear_m=courses.rear_m[tracks],
        heights_m=_heights_m(scene, estimates)[cells],
        sizes=estimates.sizes[tracks],
        class_ids=estimates.class_ids[tracks],
        existence=existence[tracks],
        ages_s=(scene.stamps_ns[frames] - first_ns[tracks]) / 1e9,
        fronts_known=estimates.fronts_known[tracks],
        speeds_known=is_measured[tracks] & is_possible,
        seen=np.where(sightings >= 0, sightings - scene.starts[frames], NOT_SEEN),
    )
    bounds = np.searchsorted(frames, np.arange(len(scene.stamps_s) + 1))
    return [rows.select(np.arange(first, last)) for first, last in pairwise(bounds.tolist())]


def _heights_m(scene: Scene, estimates: Estimates) -> F64:
    """(N,) z of the centre of each cell, from its smoothed underside and the track's height."""
    courses, cells = estimates.courses, np.flatnonzero(estimates.are_seen)
    tracks, frames = courses.cell_tracks, courses.cell_frames
    sightings = scene.sightings.select(estimates.sightings[cells])
    undersides_m, variances = np.zeros(len(frames)), np.ones(len(frames))
    undersides_m[cells] = sightings.undersides_m
    variances[cells] = underside_variances(sightings.point_counts)
    xy = estimates.motions.states[:, :2]
    objects_m = np.linalg.norm(np.diff(xy, axis=0, prepend=xy[:1]), axis=1)
    rig_m = np.linalg.norm(np.diff(scene.sites_xy, axis=0, prepend=scene.sites_xy[:1]), axis=1)
    climbs = climb_variances(objects_m, rig_m[frames])
    road_m = road_heights(courses, estimates.are_seen, undersides_m, variances, objects_m)
    undersides_m = road_m + smoothed_undersides(courses, estimates.are_seen, undersides_m - road_m, variances, climbs)
    return np.asarray(undersides_m + estimates.sizes[tracks, 2] / 2)
