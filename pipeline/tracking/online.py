"""Tracks frame by frame, without knowledge of the future, as for a live system.

Predicted tracks and the sightings of a frame are assigned to each other at the lowest cost (Hungarian method), first
those that the frame by itself reports, then the improbable ones, which may only continue a known track (the two stages
of ByteTrack: Zhang et al., ECCV 2022). The cost is the negative log likelihood of position, heading and class. The log
odds of the existence of a track change with each sighting and each miss (Musicki and Evans, Joint integrated
probabilistic data association, 2004). The size of a track is the mean of its boxes, weighted by their points.
"""

from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, Table, join_rows, replace_rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.detectors.log_odds import logit, softly_limited
from lidcam.pipeline.fusion.assignment import assign
from lidcam.pipeline.fusion.belief.odds import probability
from lidcam.pipeline.tracking.modes import Modes
from lidcam.pipeline.tracking.motion import (
    HEADING,
    SPEED,
    STATE,
    TURN,
    Motions,
    Priors,
    at_centers,
    at_rear_axles,
    innovations,
    predicted,
)
from lidcam.pipeline.tracking.sightings import (
    FORWARD_LOG_ODDS,
    FRONT_PRIOR_VOTES,
    MIN_FRONT_TRAVEL,
    MIN_MEASUREMENTS,
    NO_BELIEF,
    NOT_SEEN,
    SHARED_ERROR,
    WEAK_NOISE,
    FrameSightings,
    Sightings,
    TrackRows,
    forward_log_odds,
    measurement_covariances,
    shows_part,
    shows_whole,
    size_weights,
)
from lidcam.pipeline.tracking.smoothing import FRAME_CORRELATION

MAX_DISTANCE = 16.0
"""Maximum squared Mahalanobis distance in x and y of an assigned sighting that the frame by itself reports."""

MAX_WEAK_DISTANCE = 9.0
"""The same of a sighting that it does not report."""

NEW_COST = 2 * np.log(70.0)
"""Cost of an unseen track and a new one instead: there is one new object in 70 squares of a motion scale, or in 1,000
square metres for cars."""

HEADING_WEIGHT = 0.5
"""Weight of the squared heading innovation in the cost of an assignment."""

MAX_HEADING_COST = 9.0
"""Maximum squared heading innovation, in standard deviations."""

HEADING_SIGMA_RAD = 0.1
"""Standard deviation added to headings in the cost, radians."""

SAME_CLASS_LIKELIHOOD = 0.9
"""Likelihood of the class of a sighting, given that of its track."""

ANY_CLASS_LIKELIHOOD = 0.02
"""Likelihood of any class of a sighting."""

MIN_HITS = 3
"""Minimum number of sightings of an established track."""

MAX_UNSEEN_S = 1.0
"""Maximum time without a sighting before an established track ends, seconds."""

MAX_NEW_UNSEEN_S = 0.3
"""The same of a new track."""

MAX_MODE_SPREAD = 0.1
"""Maximum standard deviation of the speed of a new track over whether it stands or moves, before its speed is known, in
speeds of `Priors`."""

MAX_COASTING_S = 0.3
"""Maximum time without a sighting while an established track is reported, seconds."""

EVIDENCE_WEIGHT = 0.5
"""Weight of the evidence of one frame: frames are not independent."""

MEMORY_S = 1.0
"""Time constant with which evidence of existence fades, seconds."""

FADED_LOG_ODDS = -1.0
"""Log odds of existence to which a track fades."""

MAX_NEW_LOG_ODDS = 2.0
"""Maximum absolute log odds of existence of a new track."""

DOUBT_LOG_ODDS = -1.0
"""Log odds added to a new track by each frame shortly before it, in which it was not seen."""

MAX_DOUBT_S = 0.25
"""Maximum age of these frames, seconds; without any, as in the first frame, nothing counts against a track."""

MIN_HIT_SHARE, MAX_HIT_SHARE = 0.1, 0.8
"""Bounds of the assumed share of frames in which a track is seen; the larger it is, the more a miss counts."""

TIME_TOLERANCE_S = 1e-6
"""Tolerance of the limits above, seconds: times are sums of rounded ones."""

MIN_TRACK_DISTANCE = 0.4
"""Minimum distance of a new track from others, in lengths of its class or motion scales, whichever is shorter."""


@dataclass(frozen=True, slots=True, eq=False)
class _Live(Table):
    """N live tracks. Positions are those of the rear axles if the front is known, else those of the centres."""

    ids: I64
    modes: Modes
    log_odds: F64
    votes: F64
    born_s: F64
    seen_s: F64
    frames: I64
    hits: I64
    along_m: F64
    front_votes: F64
    size_sums: F64  # (N, C, 3), of the boxes of each class
    size_weights: F64
    heights_m: F64
    rear_m: F64
    fronts_known: Bools
    speeds_known: Bools
    shared_covariances: F64

    @property
    def motions(self) -> Motions:
        return self.modes.combined()

    @property
    def class_ids(self) -> I64:
        return np.asarray(self.votes.argmax(1))

    def sizes(self, priors: Priors) -> F64:
        """(N, 3) by the boxes of its class, and of one that is a little longer."""
        is_whole = shows_whole(np.arange(len(priors)), self.class_ids[:, None], priors)
        of_classes = np.where(is_whole, 1.0, NO_BELIEF)[..., None]
        return np.asarray((of_classes * self.size_sums).sum(1) / (of_classes * self.size_weights).sum(1))


class OnlineTracker:
    """Tracks of frames that come in order.

    Attributes:
        ids_of_sightings: (N,) track of each sighting of the last frame; 0 for none.
    """

    def __init__(self, priors: Priors, *, min_existence: float, max_gap_s: float) -> None:
        """Report tracks from a probability on; beyond a gap between frames, all tracks are new."""
        self._max_gap_s = max_gap_s
        self._priors, self._min_existence = priors, min_existence
        self._live: _Live | None = None
        self._next_id = 1
        self._start_ns = 0
        self._now_s = 0.0
        self._recent_s = np.zeros(0)  # times of the frames no more than `MAX_DOUBT_S` before
        self.ids_of_sightings: I64 = np.zeros(0, np.int64)

    def add_frame(self, frame: FrameSightings) -> list[TrackRows]:
        """The tracks that are reported in the next frame."""
        sightings = frame.sightings
        noise = measurement_covariances(sightings, self._priors)
        if self._live is None:
            self._start_ns = frame.stamp_ns
            self._live = self._new_tracks(sightings, noise, np.zeros(0, np.intp))
        before_s, self._now_s = self._now_s, (frame.stamp_ns - self._start_ns) / 1e9
        if self._now_s < before_s:  # time has jumped back: what was seen is of another time
            self._live, self._recent_s, before_s = self._live.select(np.zeros(0, np.intp)), np.zeros(0), self._now_s
        self._recent_s = self._recent_s[self._now_s - self._recent_s <= MAX_DOUBT_S + TIME_TOLERANCE_S]
        live = self._live.select(self._now_s - self._live.seen_s <= self._max_gap_s + TIME_TOLERANCE_S)
        live = self._predicted(live, self._now_s - before_s)
        track_of = self._assigned(live, sightings, noise)
        live = self._updated(live, track_of, sightings, noise)
        live = self._with_known_speeds(self._with_fronts(live))
        begins = self._beginnings(live, track_of, sightings)
        track_of[begins] = len(live) + np.arange(len(begins))
        live = join_rows(live, self._new_tracks(sightings, noise, begins))
        rows = np.flatnonzero(track_of >= 0)
        seen = np.full(len(live), NOT_SEEN, np.int64)
        seen[track_of[rows]] = rows
        self.ids_of_sightings = np.zeros(len(sightings), np.int64)
        self.ids_of_sightings[rows] = live.ids[track_of[rows]]
        max_unseen_s = np.where(live.hits >= MIN_HITS, MAX_UNSEEN_S, MAX_NEW_UNSEEN_S)
        kept = self._now_s - live.seen_s <= max_unseen_s + TIME_TOLERANCE_S
        self._live = live.select(kept)
        self._recent_s = np.append(self._recent_s, self._now_s)
        return [self._rows(self._live, seen[kept])]

    def finish(self) -> list[TrackRows]:
        """No frame waits."""
        return []

    def _predicted(self, live: _Live, after_s: float) -> _Live:
        along_m = live.along_m + live.motions.states[:, SPEED] * after_s
        log_odds = FADED_LOG_ODDS + (live.log_odds - FADED_LOG_ODDS) * np.exp(-after_s / MEMORY_S)
        modes = live.modes.predicted(after_s, self._priors.noise[live.class_ids])
        return replace(live, modes=modes, log_odds=log_odds, along_m=along_m)

    def _assigned(self, live: _Live, sightings: Sightings, noise: F64) -> Indices:
        """(N,) track of each sighting; -1 for none."""
        track_of = np.full(len(sightings), -1)
        for in_stage, gate in ((sightings.are_reported, MAX_DISTANCE), (~sightings.are_reported, MAX_WEAK_DISTANCE)):
            tracks = np.setdiff1d(np.arange(len(live)), track_of)
            rows = np.flatnonzero(in_stage)
            if len(tracks) and len(rows):
                first, second = self._pairs(live.select(tracks), sightings.select(rows), noise[rows], gate)
                track_of[rows[second]] = tracks[first]
        return track_of

    def _pairs(self, live: _Live, sightings: Sightings, noise: F64, gate: float) -> tuple[Indices, Indices]:
        """Rows of tracks and of sightings that belong together."""
        modes = live.modes
        near = [_within_reach(one, live.rear_m, sightings, noise, gate) for one in (modes.standing, modes.moving)]
        track, row = np.nonzero(np.logical_or(*near))
        modes, class_ids, noise = modes.select(track), sightings.class_ids[row], noise[row]
        scale_m2, turns = self._priors.scales_m[live.class_ids[track]] ** 2, self._priors.show_axis[class_ids]
        distances, log_likelihoods = [], []
        for motions, share in ((modes.standing, 1 - modes.moves), (modes.moving, modes.moves)):
            beside, slopes = innovations(motions, sightings.boxes[row], sightings.later_s[row], live.rear_m[track])
            spread = slopes @ motions.covariances @ slopes.swapaxes(1, 2) + noise
            x, y, xx, xy, yy = beside[:, 0], beside[:, 1], spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
            determinant = xx * yy - xy**2
            distances.append((yy * x**2 - 2 * xy * x * y + xx * y**2) / determinant)
            turned = np.minimum(beside[:, 2] ** 2 / (spread[:, 2, 2] + HEADING_SIGMA_RAD**2), MAX_HEADING_COST)
            cost = distances[-1] + np.log(determinant / scale_m2**2) + HEADING_WEIGHT * turns * turned
            log_likelihoods.append(np.log(share) - cost / 2)
        distance, costs = np.minimum(*distances), -2 * np.logaddexp(*log_likelihoods)
        shares = live.votes[track, class_ids] / live.votes.sum(1)[track]
        costs -= 2 * np.log(SAME_CLASS_LIKELIHOOD * shares + ANY_CLASS_LIKELIHOOD)
        costs -= 2 * np.log(np.maximum(sightings.beliefs[row], 0.05))
        matrix, fits = np.zeros((len(live), len(sightings))), distance < gate
        matrix[track[fits], row[fits]] = np.minimum(costs[fits] - NEW_COST, 0.0)
        first, second = assign(matrix)
        paired = matrix[first, second] < 0
        return first[paired], second[paired]

    def _updated(self, live: _Live, track_of: Indices, sightings: Sightings, noise: F64) -> _Live:
        rows = np.flatnonzero(track_of >= 0)
        tracks, sightings, noise = track_of[rows], sightings.select(rows), noise[rows]
        missed = np.ones(len(live), np.bool_)
        missed[tracks] = False
        hit_share = np.clip(live.hits / np.maximum(live.frames, 1), MIN_HIT_SHARE, MAX_HIT_SHARE)
        log_odds = live.log_odds + np.where(missed, EVIDENCE_WEIGHT * np.log(1 - hit_share), 0.0)
        live = replace(live, log_odds=log_odds, frames=live.frames + 1)
        seen, beliefs = live.select(tracks), sightings.beliefs
        are_parts = shows_part(sightings.class_ids, seen.class_ids, self._priors)
        is_weak = are_parts | ~sightings.are_reported
        noise = np.where(is_weak[:, None, None], WEAK_NOISE, 1.0) * noise
        rolling_m_s = self._priors.noise[seen.class_ids, -1]
        modes = seen.modes.updated(sightings.boxes, sightings.later_s, seen.rear_m, noise, rolling_m_s)
        after = modes.combined()
        weights = self._by_class(sightings, self._priors.are_solid[seen.class_ids])
        votes = seen.votes.copy()
        votes[np.arange(len(seen)), sightings.class_ids] += beliefs
        agreement = np.sign(np.cos(sightings.boxes[:, 2] - after.states[:, HEADING]))
        # The first speed is evidence, too: two objects side by side are no fast one.
        by_speed = -0.5 * (after.states[:, SPEED] / self._priors.speeds[seen.class_ids]) ** 2 * (seen.hits == 1)
        seen = replace(
            seen,
            modes=modes,
            log_odds=seen.log_odds + EVIDENCE_WEIGHT * (logit(beliefs) + by_speed),
            votes=votes,
            seen_s=np.full(len(seen), self._now_s),
            hits=seen.hits + 1,
            front_votes=seen.front_votes + beliefs * sightings.show_front * agreement,
            size_sums=seen.size_sums + weights * sightings.sizes[:, None],
            size_weights=seen.size_weights + weights,
            heights_m=sightings.heights_m,
            shared_covariances=np.where(
                is_weak[:, None, None], seen.shared_covariances, SHARED_ERROR * noise[:, :2, :2]
            ),
        )
        return replace_rows(live, tracks, seen)

    def _by_class(self, sightings: Sightings, are_solid: Bools) -> F64:
        """(N, C, 3) `size_weights`, zero but for the class of each box."""
        is_class = np.arange(len(self._priors)) == sightings.class_ids[:, None]
        return np.asarray(is_class[..., None] * size_weights(sightings, sightings.beliefs, are_solid)[:, None])

    def _with_fronts(self, live: _Live) -> _Live:
        """Turn tracks that seem to drive backwards, and those that have not moved if most boxes show them turned round.

        Once the front is known, positions are those of the rear axles.
        """
        lengths = live.sizes(self._priors)[:, 0]
        min_travel_m = MIN_FRONT_TRAVEL * np.minimum(lengths, self._priors.scales_m[live.class_ids])
        moved = np.abs(live.along_m) > min_travel_m
        votes = np.abs(live.front_votes) / FRAME_CORRELATION / FRONT_PRIOR_VOTES
        shown = np.where(self._priors.are_solid[live.class_ids], np.sign(live.front_votes) * np.log1p(votes), 0.0)
        shown = shown + forward_log_odds(live.along_m, self._priors.scales_m[live.class_ids])
        known = live.fronts_known | (moved & (np.abs(shown) > FORWARD_LOG_ODDS))
        turned = np.where(moved, shown < 0, ~live.fronts_known & (live.front_votes < 0))
        if not turned.any() and not (known & ~live.fronts_known).any():
            return live
        signs = np.where(turned, -1.0, 1.0)
        rear_m = np.where(known, self._priors.select(live.class_ids).rear_m(lengths), 0.0)

        def turn(motions: Motions) -> Motions:
            centers = at_centers(motions, live.rear_m)
            states, covariances = centers.states, centers.covariances
            states[turned, HEADING] += np.pi
            states[:, SPEED] *= signs
            covariances[:, SPEED] *= signs[:, None]
            covariances[:, :, SPEED] *= signs[:, None]
            return at_rear_axles(centers, rear_m)

        return replace(
            live,
            modes=live.modes.in_both(turn),
            along_m=signs * live.along_m,
            front_votes=signs * live.front_votes,
            rear_m=rear_m,
            fronts_known=known,
        )

    def _with_known_speeds(self, live: _Live) -> _Live:
        """Speeds stay known once they are: before, they are a mean of standing and of moving, which is neither."""
        spreads = live.modes.speed_spreads() / self._priors.speeds[live.class_ids]
        known = (live.hits >= MIN_MEASUREMENTS) & (spreads <= MAX_MODE_SPREAD)
        return replace(live, speeds_known=live.speeds_known | known)

    def _beginnings(self, live: _Live, track_of: Indices, sightings: Sightings) -> Indices:
        """(M,) sightings with which tracks begin: reported, without a track, and not near another one."""
        rows = np.flatnonzero((track_of < 0) & sightings.are_reported)
        rows = rows[np.argsort(-sightings.beliefs[rows], kind="stable")]
        positions = sightings.boxes[rows, :2]
        others = np.concatenate([at_centers(live.motions, live.rear_m).states[:, :2], positions])
        distances_m = np.linalg.norm(positions[:, None] - others, axis=-1)
        of_class = self._priors.select(sightings.class_ids[rows])
        is_near = distances_m < MIN_TRACK_DISTANCE * np.minimum(of_class.lengths_m, of_class.scales_m)[:, None]
        exists = np.arange(len(others)) < len(live)
        for row in range(len(rows)):
            exists[len(live) + row] = not is_near[row, exists].any()
        return rows[exists[len(live) :]]

    def _new_tracks(self, sightings: Sightings, noise: F64, rows: Indices) -> _Live:
        """Tracks that begin with the sightings in these rows."""
        sightings, noise, n = sightings.select(rows), noise[rows], len(rows)
        states, covariances = np.zeros((n, STATE)), np.zeros((n, STATE, STATE))
        states[:, :3], covariances[:, :3, :3] = sightings.boxes, noise
        covariances[:, HEADING, HEADING] = np.minimum(covariances[:, HEADING, HEADING], 3.0)
        covariances[:, SPEED, SPEED] = self._priors.speeds[sightings.class_ids] ** 2
        covariances[:, TURN, TURN] = 0.5**2
        # Boxes are measured beside the stamp of the frame: how far beside is as unknown as the speed.
        measured = Motions(states, covariances)
        motions, _ = predicted(measured, -sightings.later_s, self._priors.noise[sightings.class_ids])
        beliefs, now_s = sightings.beliefs, np.full(n, self._now_s)
        log_odds = EVIDENCE_WEIGHT * (logit(beliefs) + DOUBT_LOG_ODDS * len(self._recent_s))
        votes = np.full((n, len(self._priors)), 1e-3)
        votes[np.arange(n), sightings.class_ids] += beliefs
        weights = self._by_class(sightings, self._priors.are_solid[sightings.class_ids])
        first_id, self._next_id = self._next_id, self._next_id + n
        return _Live(
            ids=np.arange(first_id, first_id + n),
            modes=Modes.of_new(measured, motions),
            log_odds=softly_limited(log_odds, MAX_NEW_LOG_ODDS),
            votes=votes,
            born_s=now_s,
            seen_s=now_s,
            frames=np.zeros(n, np.int64),
            hits=np.ones(n, np.int64),
            along_m=np.zeros(n),
            front_votes=beliefs * sightings.show_front,
            size_sums=weights * sightings.sizes[:, None],
            size_weights=weights,
            heights_m=sightings.heights_m,
            rear_m=np.zeros(n),
            fronts_known=np.zeros(n, np.bool_),
            speeds_known=np.zeros(n, np.bool_),
            shared_covariances=SHARED_ERROR * noise[:, :2, :2],
        )

    def _rows(self, live: _Live, seen: I64) -> TrackRows:
        centers = at_centers(live.motions, live.rear_m)
        centers.states[:, HEADING] = wrap_angle(centers.states[:, HEADING])
        centers.covariances[:, :2, :2] += live.shared_covariances
        rows = TrackRows(
            ids=live.ids,
            states=centers.states,
            covariances=centers.covariances,
            rear_m=live.rear_m,
            heights_m=live.heights_m,
            sizes=live.sizes(self._priors),
            class_ids=live.class_ids,
            existence=probability(live.log_odds),
            ages_s=self._now_s - live.born_s,
            fronts_known=live.fronts_known,
            speeds_known=live.speeds_known
            & (np.abs(centers.states[:, SPEED]) <= self._priors.max_speeds[live.class_ids]),
            seen=seen,
        )
        max_coasting_s = np.where(live.hits >= MIN_HITS, MAX_COASTING_S + TIME_TOLERANCE_S, 0.0)
        is_reported = (rows.existence >= self._min_existence) & (self._now_s - live.seen_s <= max_coasting_s)
        return rows.select(is_reported)


def _within_reach(motions: Motions, rear_m: F64, sightings: Sightings, noise: F64, gate: float) -> Bools:
    """(T, N) pairs that the gate may let pass: most pairs of a crowded frame are far apart.

    A squared Mahalanobis distance is no less than the squared distance over the sum of the variances.
    """
    centers, late_s = at_centers(motions, rear_m), np.abs(sightings.later_s)
    _, _, heading, speed, turn = np.sqrt(np.diagonal(motions.covariances, axis1=1, axis2=2)).T
    fastest = np.abs(motions.states[:, SPEED]) + rear_m * np.abs(motions.states[:, TURN])
    spreads = speed + fastest * heading + (fastest + rear_m) * turn
    sigmas_m = [np.sqrt(np.trace(one[:, :2, :2], axis1=1, axis2=2)) for one in (centers.covariances, noise)]
    reach_m = np.sqrt(gate) * np.add.outer(*sigmas_m) + np.outer(fastest + np.sqrt(gate) * spreads, late_s)
    away = sightings.boxes[:, :2] - centers.states[:, None, :2]
    return np.asarray(np.hypot(away[..., 0], away[..., 1]) <= reach_m)
