"""Tracks frame by frame: what a live system could say.

Predicted tracks and the sightings of a frame are assigned to each other at least cost (Hungarian method), first those
that the frame by itself reports, then those that it finds too improbable, which may only carry on a known track (the
two stages of ByteTrack: Zhang et al., ECCV 2022). The cost is the negative log likelihood of place, heading and class.
A track exists with a probability, whose log odds each sighting and each miss change (Musicki and Evans, Joint
integrated probabilistic data association, 2004).
"""

from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, Table, join_rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.detectors.log_odds import logit
from lidcam.pipeline.fusion.assignment import assign
from lidcam.pipeline.fusion.belief.odds import probability
from lidcam.pipeline.tracking.motion import (
    HEADING,
    SPEED,
    STATE,
    TURN,
    Motions,
    Priors,
    at_centers,
    at_rear_axles,
    expected,
    innovations,
    predicted,
    updated,
)
from lidcam.pipeline.tracking.rows import NOT_SEEN, TrackRows
from lidcam.pipeline.tracking.sightings import FRONT_SHARE, SHARED_ERROR, FrameSightings, Sightings, measured

GATE, GATE_WEAK = 16.0, 9.0
"""Squared Mahalanobis distance in x and y up to which a sighting may belong to a track: of what the frame by itself
reports, and of what it does not."""

JUMP_SHARE = 0.06
"""Standard deviation that the completion of boxes adds to their places, as a share of the length of the class."""

HEADING_WEIGHT, HEADING_MOST, HEADING_SIGMA_RAD = 0.5, 9.0, 0.1
SAME_CLASS, OTHER_CLASS = 0.9, 0.02
"""Likelihood of the class of a sighting given that of its track, and of any class."""

LOST_S, LOST_NEW_S, NEW_HITS = 1.0, 0.3, 3
"""A track ends after so long without a sighting; after the second time if it has fewer sightings than this."""

EVIDENCE_SHARE = 0.5
"""Share of the evidence of one frame that counts: frames are not independent."""

LEAST_SURE, SUREST, SUREST_NEW = -5.0, 7.0, 2.0
"""Bounds of the log odds of existence, and the upper one of a new track."""

DOUBT_LOG_ODDS, DOUBT_S = -1.0, 0.25
"""What each frame says against a track that begins so soon after it. Where there is none, in the first frame and in
frames that are far apart, nothing speaks against it."""

FEWEST_SEEN, MOST_SEEN = 0.1, 0.8
"""Bounds of the share of frames in which a track is taken to be seen; a miss speaks against it the more, the larger."""

COASTING_S = 0.3
"""How long a track of `NEW_HITS` sightings and more is reported without another one."""

NEAR_SHARE = 0.4
"""No track begins nearer to another than this share of the length of its class."""


@dataclass(frozen=True, slots=True, eq=False)
class _Live(Table):
    """N tracks that are alive. Places are those of the rear axles if the front is known, else those of the centres."""

    ids: I64
    states: F64
    covariances: F64
    log_odds: F64
    votes: F64
    born_s: F64
    seen_s: F64
    frames: I64
    hits: I64
    along_m: F64
    front_votes: F64
    size_sums: F64
    size_weights: F64
    heights_m: F64
    rear_m: F64
    fronts_known: Bools
    shared: F64

    @property
    def motions(self) -> Motions:
        return Motions(self.states, self.covariances)

    @property
    def class_ids(self) -> I64:
        return np.asarray(self.votes.argmax(1))

    @property
    def sizes(self) -> F64:
        return self.size_sums / self.size_weights[:, None]


class OnlineTracker:
    """Tracks of frames that come in order.

    Attributes:
        ids_of_sightings: (N,) track of each sighting of the last frame; 0 for none.
    """

    def __init__(self, priors: Priors, *, least_existence: float, max_gap_s: float) -> None:
        """Track; what exists less probably than `least_existence` is not reported.

        Where frames are more than `max_gap_s` apart, all tracks are new.
        """
        self._max_gap_s = max_gap_s
        self._priors, self._least = priors, float(logit(np.array(least_existence)))
        self._live, self._next_id = _none(len(priors)), 1
        self._start_ns: int | None = None
        self._now_s = 0.0
        self._recent_s = np.zeros(0)  # times of the frames no more than `DOUBT_S` before
        self.ids_of_sightings: I64 = np.zeros(0, np.int64)

    def add(self, frame: FrameSightings) -> list[TrackRows]:
        """Take in the next frame; the tracks that are reported in it."""
        return [self.tracks(frame)]

    def finish(self) -> list[TrackRows]:
        """No frame waits."""
        return []

    def tracks(self, frame: FrameSightings) -> TrackRows:
        """The tracks that are reported in the next frame."""
        if self._start_ns is None:
            self._start_ns = frame.stamp_ns
        now_s = (frame.stamp_ns - self._start_ns) / 1e9
        after_s, self._now_s = now_s - self._now_s, now_s
        self._recent_s = self._recent_s[now_s - self._recent_s <= DOUBT_S]
        self._live = self._live.select(now_s - self._live.seen_s <= self._max_gap_s)
        self._predict(after_s)
        sightings = frame.sightings
        boxes, noise = measured(sightings, self._priors, JUMP_SHARE)
        track_of = np.full(len(sightings), -1)
        for is_stage, gate in ((sightings.are_reported, GATE), (~sightings.are_reported, GATE_WEAK)):
            free = np.ones(len(self._live), np.bool_)
            free[track_of[track_of >= 0]] = False
            tracks, rows = self._assigned(np.flatnonzero(free), np.flatnonzero(is_stage), sightings, boxes, noise, gate)
            track_of[rows] = tracks
        self._update(track_of, sightings, boxes, noise)
        self._settle_fronts()
        track_of = self._begin(track_of, sightings, boxes, noise)
        seen = np.full(len(self._live), NOT_SEEN, np.int64)
        rows = np.flatnonzero(track_of >= 0)
        seen[track_of[rows]] = rows
        self.ids_of_sightings = np.zeros(len(sightings), np.int64)
        self.ids_of_sightings[rows] = self._live.ids[track_of[rows]]
        unseen_s = now_s - self._live.seen_s
        lost_s = np.where(self._live.hits >= NEW_HITS, LOST_S, LOST_NEW_S)
        kept = unseen_s <= lost_s
        self._live, seen = self._live.select(kept), seen[kept]
        self._recent_s = np.append(self._recent_s, now_s)
        return self._rows(seen)

    def _predict(self, after_s: float) -> None:
        live = self._live
        moved, _ = predicted(live.motions, after_s, self._priors.noise[live.class_ids])
        along_m = live.along_m + live.states[:, SPEED] * after_s
        self._live = replace(live, states=moved.states, covariances=moved.covariances, along_m=along_m)

    def _assigned(
        self, tracks: Indices, rows: Indices, sightings: Sightings, boxes: F64, noise: F64, gate: float
    ) -> tuple[Indices, Indices]:
        """Tracks and the sightings that belong to them, among these."""
        if not len(tracks) or not len(rows):
            return tracks[:0], rows[:0]
        live, shape = self._live, (len(tracks), len(rows))
        track, row = np.repeat(tracks, len(rows)), np.tile(rows, len(tracks))
        motions = Motions(live.states[track], live.covariances[track])
        places, slopes = expected(motions, sightings.later_s[row], live.rear_m[track])
        spread = slopes @ motions.covariances @ slopes.swapaxes(1, 2) + noise[row]
        away = innovations(boxes[row], places)
        x, y, xx, xy, yy = away[:, 0], away[:, 1], spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
        size = xx * yy - xy**2
        far = (yy * x**2 - 2 * xy * x * y + xx * y**2) / size
        turned = np.minimum(away[:, 2] ** 2 / (spread[:, 2, 2] + HEADING_SIGMA_RAD**2), HEADING_MOST)
        turned[~self._priors.have_axis[sightings.class_ids[row]]] = 0.0
        shares = live.votes[tracks] / live.votes[tracks].sum(1, keepdims=True)
        of_class = SAME_CLASS * shares[:, sightings.class_ids[rows]] + OTHER_CLASS
        costs = far + HEADING_WEIGHT * turned + np.log(size) - 2 * np.log(of_class.ravel())
        costs -= 2 * np.log(np.maximum(sightings.beliefs[row], 0.05))
        # What lies outside of the gate costs nothing and what lies within less: as many pairs as pay are made.
        worst = float(costs.max()) + gate
        matrix = np.where(far < gate, costs - worst, 0.0).reshape(shape)
        first, second = assign(matrix)
        paired = matrix[first, second] < 0
        return tracks[first[paired]], rows[second[paired]]

    def _update(self, track_of: Indices, sightings: Sightings, boxes: F64, noise: F64) -> None:
        rows = np.flatnonzero(track_of >= 0)
        tracks, live = track_of[rows], self._live
        missed = np.ones(len(live), np.bool_)
        missed[tracks] = False
        share = np.clip(live.hits / np.maximum(live.frames, 1), FEWEST_SEEN, MOST_SEEN)
        log_odds = live.log_odds + np.where(missed, EVIDENCE_SHARE * np.log(1 - share), 0.0)
        log_odds[tracks] += EVIDENCE_SHARE * logit(sightings.beliefs[rows])
        motions = Motions(live.states[tracks], live.covariances[tracks])
        places, slopes = expected(motions, sightings.later_s[rows], live.rear_m[tracks])
        after = updated(motions, innovations(boxes[rows], places), slopes, noise[rows])
        states, covariances = live.states.copy(), live.covariances.copy()
        states[tracks], covariances[tracks] = after.states, after.covariances
        votes, seen_s, hits = live.votes.copy(), live.seen_s.copy(), live.hits.copy()
        votes[tracks, sightings.class_ids[rows]] += sightings.beliefs[rows]
        seen_s[tracks], hits[tracks] = self._now_s, hits[tracks] + 1
        sums, weights, heights_m = live.size_sums.copy(), live.size_weights.copy(), live.heights_m.copy()
        weight = sightings.beliefs[rows] ** 2
        sums[tracks] += weight[:, None] * sightings.sizes[rows]
        weights[tracks] += weight
        front_votes = live.front_votes.copy()
        front_votes[tracks] += sightings.beliefs[rows] * np.sign(np.cos(boxes[rows, 2] - after.states[:, HEADING]))
        heights_m[tracks] = sightings.heights_m[rows]
        shared = live.shared.copy()
        shared[tracks] = SHARED_ERROR * noise[rows, :2, :2]
        self._live = replace(
            live,
            states=states,
            covariances=covariances,
            log_odds=np.clip(log_odds, LEAST_SURE, SUREST),
            votes=votes,
            seen_s=seen_s,
            frames=live.frames + 1,
            hits=hits,
            front_votes=front_votes,
            size_sums=sums,
            size_weights=weights,
            heights_m=heights_m,
            shared=shared,
        )

    def _settle_fronts(self) -> None:
        """Turn round what drives backwards all the time, and before that shows, what most boxes show turned round.

        From when it shows on, places are those of the rear axles.
        """
        live = self._live
        lengths = live.sizes[:, 0]
        moved = np.abs(live.along_m) > FRONT_SHARE * np.minimum(lengths, self._priors.units_m[live.class_ids])
        known = live.fronts_known | moved
        turned = np.where(known, moved & (live.along_m < 0), live.front_votes < 0)
        if not turned.any() and not (known & ~live.fronts_known).any():
            return
        centers = at_centers(live.motions, live.rear_m)
        states = centers.states.copy()
        states[turned, HEADING] += np.pi
        states[turned, SPEED] *= -1
        signs = np.where(turned, -1.0, 1.0)
        covariances = centers.covariances.copy()
        covariances[:, SPEED] *= signs[:, None]
        covariances[:, :, SPEED] *= signs[:, None]
        rear_m = np.where(known, self._priors.select(live.class_ids).rear_m(lengths), 0.0)
        after = at_rear_axles(Motions(states, covariances), rear_m)
        self._live = replace(
            live,
            states=after.states,
            covariances=after.covariances,
            along_m=signs * live.along_m,
            front_votes=signs * live.front_votes,
            rear_m=rear_m,
            fronts_known=known,
        )

    def _begin(self, track_of: Indices, sightings: Sightings, boxes: F64, noise: F64) -> Indices:
        """Begin tracks with the sightings that are left; which track each sighting belongs to now."""
        rows = np.flatnonzero((track_of < 0) & sightings.are_reported)
        rows = rows[np.argsort(-sightings.beliefs[rows], kind="stable")]
        units_m = self._priors.units_m[sightings.class_ids[rows]]
        others = np.concatenate([at_centers(self._live.motions, self._live.rear_m).states[:, :2], boxes[rows, :2]])
        away_m = np.linalg.norm(boxes[rows, None, :2] - others, axis=-1)
        count = len(self._live)
        begins = np.zeros(len(rows), np.bool_)
        for place in range(len(rows)):
            earlier = np.concatenate([np.ones(count, np.bool_), begins])
            begins[place] = not (away_m[place] < NEAR_SHARE * units_m[place])[earlier].any()
        rows = rows[begins]
        if not len(rows):
            return track_of
        n, class_ids = len(rows), sightings.class_ids[rows]
        states, covariances = np.zeros((n, STATE)), np.zeros((n, STATE, STATE))
        states[:, :3], covariances[:, :3, :3] = boxes[rows], noise[rows]
        covariances[:, HEADING, HEADING] = np.minimum(covariances[:, HEADING, HEADING], 3.0)
        covariances[:, SPEED, SPEED] = self._priors.speeds[class_ids] ** 2
        covariances[:, TURN, TURN] = 0.5**2
        beliefs = sightings.beliefs[rows]
        votes = np.full((n, len(self._priors)), 1e-3)
        votes[np.arange(n), class_ids] += beliefs
        weights, now_s = beliefs**2, np.full(n, self._now_s)
        new = _Live(
            np.arange(self._next_id, self._next_id + n),
            states,
            covariances,
            np.minimum(EVIDENCE_SHARE * (logit(beliefs) + DOUBT_LOG_ODDS * len(self._recent_s)), SUREST_NEW),
            votes,
            now_s,
            now_s,
            np.zeros(n, np.int64),
            np.ones(n, np.int64),
            np.zeros(n),
            beliefs,
            weights[:, None] * sightings.sizes[rows],
            weights,
            sightings.heights_m[rows],
            np.zeros(n),
            np.zeros(n, np.bool_),
            SHARED_ERROR * noise[rows, :2, :2],
        )
        self._next_id += n
        track_of = track_of.copy()
        track_of[rows] = count + np.arange(n)
        self._live = join_rows(self._live, new)
        return track_of

    def _rows(self, seen: I64) -> TrackRows:
        live = self._live
        centers = at_centers(live.motions, live.rear_m)
        centers.states[:, HEADING] = wrap_angle(centers.states[:, HEADING])
        centers.covariances[:, :2, :2] += live.shared
        rows = TrackRows(
            live.ids,
            centers.states,
            centers.covariances,
            live.heights_m,
            live.sizes,
            live.class_ids,
            probability(live.log_odds),
            self._now_s - live.born_s,
            live.fronts_known,
            seen,
        )
        coasts_s = np.where(live.hits >= NEW_HITS, COASTING_S + 1e-6, 0.0)
        return rows.select((live.log_odds >= self._least) & (self._now_s - live.seen_s <= coasts_s))


def _none(class_count: int) -> _Live:
    zeros, numbers = np.zeros(0), np.zeros(0, np.int64)
    return _Live(
        numbers,
        np.zeros((0, STATE)),
        np.zeros((0, STATE, STATE)),
        zeros,
        np.zeros((0, class_count)),
        zeros,
        zeros,
        numbers,
        numbers,
        zeros,
        zeros,
        np.zeros((0, 3)),
        zeros,
        zeros,
        zeros,
        np.zeros(0, np.bool_),
        np.zeros((0, 2, 2)),
    )
