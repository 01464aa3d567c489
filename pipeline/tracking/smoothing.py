"""Tracks smoothed over a stretch of time, each state from all measurements before and after it.

All tracks are filtered forwards frame by frame and then smoothed backwards (Rauch, Tung, Striebel, Maximum likelihood
estimates of linear dynamic systems, 1965), together: a frame is one step in arrays. A cell is one frame of one track;
the cells of a track are consecutive, and so are the tracks.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, Table
from lidcam.pipeline.tracking.motion import (
    ROBUST_DISTANCE,
    SPEED,
    STATE,
    TURN,
    Motions,
    innovations,
    predicted,
    updated,
    with_known_axes,
)

FRAME_CORRELATION = 4.0
"""Number of consecutive measurements with the information of one: neighbouring frames share most of their error."""

STANDING_NOISE = np.array([1e-6, 1e-6, 1e-6, 1e-6, 1.0])
"""Share of each column of `Priors.noise` that remains while an object stands; the last is a speed, and stays."""

STANDING_SPEED_SIGMA = 0.002
"""Standard deviation of the speed of a standing object, as a share of that of its class."""

STANDING_TURN_SIGMA_RAD_S = 0.002
"""Standard deviation of the yaw rate of a standing object, rad/s."""
DRIFT_SIGMA_M = 0.05
"""Standard deviation of the error of the rig's motion over a metre of it, metres; it grows as in a random walk."""


@dataclass(frozen=True, slots=True, eq=False)
class Courses(Table):
    """T tracks, each from its first to its last frame."""

    firsts: I64  # (T,) int64, first frame
    lasts: I64  # (T,) int64, last frame
    states: F64  # (T, 5) in the first frame, with positions of the rear axles
    covariances: F64  # (T, 5, 5) of the states
    noise: F64  # (T, 5), as in `Priors`
    speeds: F64  # (T,) standard deviation of the speed of the class, m/s
    rear_m: F64  # (T,) distance of the rear axles behind the centres

    @property
    def starts(self) -> I64:
        """(T + 1,) first cell of each track, and the number of cells."""
        return np.concatenate([[0], np.cumsum(self.counts)])

    @property
    def counts(self) -> I64:
        """(T,) number of cells of each track."""
        return self.lasts - self.firsts + 1

    @property
    def cell_tracks(self) -> I64:
        """(N,) track of each cell."""
        return np.repeat(np.arange(len(self)), self.counts)

    @property
    def cell_frames(self) -> I64:
        """(N,) frame of each cell."""
        starts = self.starts
        return np.arange(starts[-1]) - np.repeat(starts[:-1] - self.firsts, self.counts)


@dataclass(frozen=True, slots=True, eq=False)
class Cells(Table):
    """The measurements of each frame of each track; placeholders where it is not seen."""

    are_seen: Bools  # (N,) bool
    boxes: F64  # (N, 3) centre and yaw
    noise: F64  # (N, 3, 3) covariances of the boxes
    later_s: F64  # (N,) time of measurement after the frame's stamp
    standing: Bools  # (N,) bool, whether the track is known to stand


def smoothed(courses: Courses, cells: Cells, stamps_s: F64, sites_xy: F64) -> Motions:
    """The states of all cells of tracks, with positions of the rear axles.

    Args:
        courses: T tracks.
        cells: Their measurements.
        stamps_s: (F,) times of the frames.
        sites_xy: (F, 2) positions of the rig, metres in the fixed frame, which drifts as it moves.
    """
    steps_m = np.linalg.norm(np.diff(sites_xy, axis=0, prepend=sites_xy[:1]), axis=1)
    count = len(cells)
    filtered, prior = (Motions(np.empty((count, STATE)), np.empty((count, STATE, STATE))) for _ in range(2))
    slopes = np.empty((count, STATE, STATE))
    offsets = courses.starts[:-1] - courses.firsts  # the cell of a track in a frame is this, plus the frame
    frames = range(int(courses.firsts.min()), int(courses.lasts.max()) + 1) if len(courses) else range(0)
    for frame in frames:
        tracks = np.flatnonzero((courses.firsts <= frame) & (frame <= courses.lasts))
        at = offsets[tracks] + frame
        begins = courses.firsts[tracks] == frame
        now = Motions(courses.states[tracks], courses.covariances[tracks])
        if not begins.all():
            continues = ~begins
            before = at[continues] - 1
            stands = cells.standing[before] & cells.standing[before + 1]
            noise = courses.noise[tracks[continues]] * np.where(stands[:, None], STANDING_NOISE, 1.0)
            after_s = stamps_s[frame] - stamps_s[frame - 1]
            moved, slopes[before] = predicted(filtered.select(before), after_s, noise)
            moved.covariances[:, [0, 1], [0, 1]] += DRIFT_SIGMA_M**2 * steps_m[frame]
            now.states[continues], now.covariances[continues] = moved.states, moved.covariances
        prior.states[at], prior.covariances[at] = now.states, now.covariances
        now = _filtered(now, courses, cells, tracks, at)
        filtered.states[at], filtered.covariances[at] = now.states, now.covariances
    return _backwards(courses, filtered, prior, slopes, frames)


def _filtered(now: Motions, courses: Courses, cells: Cells, tracks: Indices, at: Indices) -> Motions:
    """Tracks after the measurements of a frame, and the assumption of standing."""
    states, covariances = now.states.copy(), now.covariances.copy()
    stands = np.flatnonzero(cells.standing[at])
    if len(stands):
        rows = np.zeros((len(stands), 2, STATE))
        rows[:, 0, SPEED] = rows[:, 1, TURN] = 1.0
        noise = np.zeros((len(stands), 2, 2))
        noise[:, 0, 0] = (STANDING_SPEED_SIGMA * courses.speeds[tracks[stands]]) ** 2
        noise[:, 1, 1] = STANDING_TURN_SIGMA_RAD_S**2
        after = updated(now.select(stands), -states[stands][:, [SPEED, TURN]], rows, noise)
        states[stands], covariances[stands] = after.states, after.covariances
    seen = np.flatnonzero(cells.are_seen[at])
    if len(seen):
        here, motions = at[seen], Motions(states[seen], covariances[seen])
        difference, slopes = innovations(motions, cells.boxes[here], cells.later_s[here], courses.rear_m[tracks[seen]])
        noise = with_known_axes(cells.noise[here], difference, motions, courses.noise[tracks[seen], -1])
        after = updated(motions, difference, slopes, noise, ROBUST_DISTANCE)
        states[seen], covariances[seen] = after.states, after.covariances
    return Motions(states, covariances)


def _backwards(courses: Courses, filtered: Motions, prior: Motions, slopes: F64, frames: range) -> Motions:
    states, covariances = filtered.states.copy(), filtered.covariances.copy()
    offsets = courses.starts[:-1] - courses.firsts
    for frame in reversed(frames[:-1]):
        at = offsets[(courses.firsts <= frame) & (frame < courses.lasts)] + frame
        # G = P F' S^-1, by the symmetric S.
        gains = np.linalg.solve(prior.covariances[at + 1], slopes[at] @ filtered.covariances[at]).swapaxes(1, 2)
        states[at] += (gains @ (states[at + 1] - prior.states[at + 1])[..., None])[..., 0]
        covariances[at] += gains @ (covariances[at + 1] - prior.covariances[at + 1]) @ gains.swapaxes(1, 2)
    return Motions(states, covariances)
