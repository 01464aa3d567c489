"""Tracks over a stretch of time, each moment told by what came before and by what came after.

All tracks are filtered forwards frame by frame and then smoothed backwards (Rauch, Tung, Striebel, Maximum likelihood
estimates of linear dynamic systems, 1965), together: a frame is one step in arrays. A moment of a track is a cell; the
cells of a track follow each other, and so do the tracks.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, Table
from lidcam.pipeline.tracking.motion import SPEED, STATE, TURN, Motions, expected, innovations, predicted, updated

ROBUST = 9.0
"""Squared Mahalanobis distance beyond which a measurement counts less."""

STANDING_NOISE = 1e-6
"""Share of the process noise that is left while something stands."""

STANDING_SPEED_SHARE, STANDING_TURN_RAD_S = 0.002, 0.002
"""Standard deviations of the speed (as a share of that of the class) and the yaw rate of what stands."""


@dataclass(frozen=True, slots=True, eq=False)
class Courses(Table):
    """T tracks, each from its first to its last frame.

    Attributes:
        firsts: (T,) int64, first frame.
        lasts: (T,) int64, last frame.
        states: (T, 5) in the first frame; the places are those of the rear axles.
        covariances: (T, 5, 5) of them.
        noise: (T, 5), as in `Priors`.
        speeds: (T,) standard deviation of the speed of the class, m/s.
        rear_m: (T,) how far the rear axles are behind the centres.
    """

    firsts: I64
    lasts: I64
    states: F64
    covariances: F64
    noise: F64
    speeds: F64
    rear_m: F64

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
    """What is measured at each moment of each track; anything where it is not seen.

    Attributes:
        are_seen: (N,) bool.
        boxes: (N, 3) centre and yaw.
        noise: (N, 3, 3) covariances of them.
        later_s: (N,) when they were measured, after the frame.
        stand: (N,) bool, whether the track is known to stand.
    """

    are_seen: Bools
    boxes: F64
    noise: F64
    later_s: F64
    stand: Bools


def smoothed(courses: Courses, cells: Cells, stamps_s: F64) -> Motions:
    """The states of all cells, places those of the rear axles.

    Args:
        courses: T tracks.
        cells: What is measured of them.
        stamps_s: (F,) times of the frames.
    """
    count = len(cells)
    filtered, expected_ = (Motions(np.empty((count, STATE)), np.empty((count, STATE, STATE))) for _ in range(2))
    slopes = np.empty((count, STATE, STATE))
    starts = courses.starts
    frames = range(int(courses.firsts.min()), int(courses.lasts.max()) + 1) if len(courses) else range(0)
    for frame in frames:
        tracks = np.flatnonzero((courses.firsts <= frame) & (frame <= courses.lasts))
        at = starts[tracks] + frame - courses.firsts[tracks]
        begins = courses.firsts[tracks] == frame
        now = Motions(courses.states[tracks], courses.covariances[tracks])
        if not begins.all():
            goes_on = ~begins
            before = at[goes_on] - 1
            stands = cells.stand[before] & cells.stand[before + 1]
            noise = courses.noise[tracks[goes_on]] * np.where(stands, STANDING_NOISE, 1.0)[:, None]
            after_s = stamps_s[frame] - stamps_s[frame - 1]
            moved, slopes[before] = predicted(filtered.select(before), after_s, noise)
            now.states[goes_on], now.covariances[goes_on] = moved.states, moved.covariances
        expected_.states[at], expected_.covariances[at] = now.states, now.covariances
        now = _filtered(now, courses, cells, tracks, at)
        filtered.states[at], filtered.covariances[at] = now.states, now.covariances
    return _backwards(courses, filtered, expected_, slopes, frames)


def _filtered(now: Motions, courses: Courses, cells: Cells, tracks: Indices, at: Indices) -> Motions:
    """Tracks after the measurements of a frame."""
    states, covariances = now.states.copy(), now.covariances.copy()
    stands = np.flatnonzero(cells.stand[at])
    if len(stands):
        rows = np.zeros((len(stands), 2, STATE))
        rows[:, 0, SPEED] = rows[:, 1, TURN] = 1.0
        noise = np.zeros((len(stands), 2, 2))
        noise[:, 0, 0] = (STANDING_SPEED_SHARE * courses.speeds[tracks[stands]]) ** 2
        noise[:, 1, 1] = STANDING_TURN_RAD_S**2
        after = updated(now.select(stands), -states[stands][:, [SPEED, TURN]], rows, noise)
        states[stands], covariances[stands] = after.states, after.covariances
    seen = np.flatnonzero(cells.are_seen[at])
    if len(seen):
        here, motions = at[seen], Motions(states[seen], covariances[seen])
        places, slopes = expected(motions, cells.later_s[here], courses.rear_m[tracks[seen]])
        after = updated(motions, innovations(cells.boxes[here], places), slopes, cells.noise[here], ROBUST)
        states[seen], covariances[seen] = after.states, after.covariances
    return Motions(states, covariances)


def _backwards(courses: Courses, filtered: Motions, expected_: Motions, slopes: F64, frames: range) -> Motions:
    states, covariances = filtered.states.copy(), filtered.covariances.copy()
    starts = courses.starts
    for frame in reversed(frames[:-1]):
        tracks = np.flatnonzero((courses.firsts <= frame) & (frame < courses.lasts))
        at = starts[tracks] + frame - courses.firsts[tracks]
        # G = P F' S^-1, by the symmetric S.
        gains = np.linalg.solve(expected_.covariances[at + 1], slopes[at] @ filtered.covariances[at]).swapaxes(1, 2)
        states[at] += (gains @ (states[at + 1] - expected_.states[at + 1])[..., None])[..., 0]
        covariances[at] += gains @ (covariances[at + 1] - expected_.covariances[at + 1]) @ gains.swapaxes(1, 2)
    return Motions(states, covariances)
