"""Truth between its messages: each object where it was at a time that is asked for.

Objects of two messages are joined by their ids: positions are interpolated linearly, headings by the shortest way.
Objects without ids stay where the nearest message has them. Messages are read as they are needed, and forgotten.
"""

from bisect import bisect_left
from collections import deque
from dataclasses import replace
from itertools import islice

import numpy as np

from lidcam.pipeline.core.arrays import I32, Indices, join_rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes3D
from lidcam.readers.truth.moment import STEP_BACK_NS, Moment

MAX_GAP_PERIODS = 2.5
"""Largest gap between two messages that are interpolated: one may be missing."""

MAX_EXTRAPOLATION_PERIODS = 0.1
"""Longest extrapolation beyond the first and last message, or into a gap: clocks of recorders differ by as much."""

MAX_NEAREST_PERIODS = 0.5
"""Largest distance in time of a message of objects without ids, in periods."""

MAX_NEAREST_NS = 50_000_000
"""Largest distance in time of a message of objects without ids: one metre at 20 m/s."""

PROBED_GAPS = 10
"""Number of gaps between the first messages that give the period."""


class Timeline:
    """Objects at any time, from messages of some times.

    Attributes:
        nearest: Number of times that objects without ids were taken from the nearest message.
        farthest_ns: The farthest that such a message was off.
    """

    def __init__(self) -> None:
        self._kept: deque[Moment] = deque()
        self._gaps_ns: list[int] = []
        self.nearest = self.farthest_ns = 0

    @property
    def _period_ns(self) -> int:
        """The usual time between two messages; 0 of fewer than two."""
        return sorted(self._gaps_ns)[len(self._gaps_ns) // 2] if self._gaps_ns else 0

    def add_moment(self, moment: Moment) -> None:
        """Take a message; where time steps back by more than `STEP_BACK_NS`, those before it are forgotten."""
        if self._kept and moment.stamp_ns < self._kept[-1].stamp_ns - STEP_BACK_NS:
            self._kept.clear()
        if not self._kept or moment.stamp_ns > self._kept[-1].stamp_ns:
            if self._kept and len(self._gaps_ns) < PROBED_GAPS:
                self._gaps_ns.append(moment.stamp_ns - self._kept[-1].stamp_ns)
            self._kept.append(moment)
            return
        others = [one for one in self._kept if one.stamp_ns != moment.stamp_ns]
        self._kept = deque(sorted([*others, moment], key=lambda one: one.stamp_ns))

    def forget(self, before_ns: int) -> None:
        """Forget messages that are not needed for times from `before_ns` on."""
        while len(self._kept) > 2 and self._kept[1].stamp_ns <= before_ns:
            self._kept.popleft()

    def reaches(self, stamp_ns: int) -> bool:
        """Whether further messages will not change what is known of a time."""
        stamps = [moment.stamp_ns for moment in islice(reversed(self._kept), 2)]
        if len(self._gaps_ns) < PROBED_GAPS or not stamps or stamps[0] < stamp_ns:
            return False
        if stamps[0] == stamp_ns or len(stamps) == 1:
            return stamps[0] == stamp_ns
        return stamps[1] >= stamp_ns or stamps[0] - stamps[1] <= MAX_GAP_PERIODS * self._period_ns

    def at(self, stamp_ns: int) -> Moment | None:
        """The objects at a time; None if no messages are near enough."""
        stamps = [moment.stamp_ns for moment in self._kept]
        after = bisect_left(stamps, stamp_ns)
        if after < len(stamps) and stamps[after] == stamp_ns:
            return self._kept[after]
        first = max(min(after, len(stamps) - 1) - 1, 0)
        around = [self._kept[row] for row in range(first, min(first + 2, len(stamps)))]
        return self._between(stamp_ns, *around) if around else None

    def _between(self, stamp_ns: int, first: Moment, second: Moment | None = None) -> Moment | None:
        """The objects at a time between two messages, or just beyond one of them."""
        last = first if second is None else second
        nearer = first if abs(stamp_ns - first.stamp_ns) <= abs(stamp_ns - last.stamp_ns) else last
        off_ns = abs(stamp_ns - nearer.stamp_ns)
        is_beside = off_ns <= MAX_EXTRAPOLATION_PERIODS * self._period_ns
        gap_ns = last.stamp_ns - first.stamp_ns
        if not 0 < gap_ns <= MAX_GAP_PERIODS * self._period_ns or first.boxes.frame_id != last.boxes.frame_id:
            return _placed(nearer, stamp_ns) if is_beside else None
        if not (is_beside or first.stamp_ns < stamp_ns < last.stamp_ns):
            return None
        if _has_ids(first) and _has_ids(last):
            return _interpolated(stamp_ns, first, last)
        if off_ns > min(MAX_NEAREST_PERIODS * self._period_ns, MAX_NEAREST_NS):
            return None
        self.nearest += 1
        self.farthest_ns = max(self.farthest_ns, off_ns)
        return _placed(nearer, stamp_ns)


def _has_ids(moment: Moment) -> bool:
    """Whether every object has an id of its own."""
    ids = moment.boxes.track_ids
    return bool((ids != UNKNOWN).all()) and len(np.unique(ids)) == len(ids)


def _placed(moment: Moment, stamp_ns: int) -> Moment:
    return replace(moment, boxes=replace(moment.boxes, stamp_ns=stamp_ns))


def _interpolated(stamp_ns: int, first: Moment, second: Moment) -> Moment:
    """The objects of two messages at a time between them, or just beyond; rows as in the nearer one.

    An object that only the nearer message has came or went: it is where that message has it, and ignored.
    """
    share = (stamp_ns - first.stamp_ns) / (second.stamp_ns - first.stamp_ns)
    near, far, step = (first, second, share) if share <= 0.5 else (second, first, 1 - share)
    rows, others = _same(near.boxes, far.boxes)
    centers, yaws = near.boxes.centers.copy(), near.boxes.yaws.copy()
    centers[rows] += step * (far.boxes.centers[others] - centers[rows])
    yaws[rows] = wrap_angle(yaws[rows] + step * wrap_angle(far.boxes.yaws[others] - yaws[rows]))
    is_ignored = np.ones(len(yaws), np.bool_)
    is_ignored[rows] = near.boxes.is_ignored[rows] | far.boxes.is_ignored[others]
    boxes = replace(near.boxes, stamp_ns=stamp_ns, centers=centers, yaws=yaws, is_ignored=is_ignored)
    moved = replace(near, boxes=boxes)
    if len(others) == len(far.boxes):
        return moved
    lone = far.select(np.setdiff1d(np.arange(len(far.boxes)), others))
    ignored = replace(lone.boxes, stamp_ns=stamp_ns, is_ignored=np.ones(len(lone.boxes), np.bool_))
    return _joined(moved, replace(lone, boxes=ignored))


def _same(near: TruthBoxes3D, far: TruthBoxes3D) -> tuple[Indices, Indices]:
    """Rows of the objects that two messages have in common, of the one and of the other."""
    if np.array_equal(near.track_ids, far.track_ids):  # as in most messages
        return (rows := np.arange(len(near))), rows
    _, rows, others = np.intersect1d(near.track_ids, far.track_ids, assume_unique=True, return_indices=True)
    return rows, others


def _joined(first: Moment, second: Moment) -> Moment:
    cameras = sorted({*first.camera_pixels, *second.camera_pixels})
    pixels = {camera: np.concatenate([_pixels(first, camera), _pixels(second, camera)]) for camera in cameras}
    return Moment(join_rows(first.boxes, second.boxes), pixels)


def _pixels(moment: Moment, camera: str) -> I32:
    return moment.camera_pixels.get(camera, np.full(len(moment.boxes), UNKNOWN, np.int32))
