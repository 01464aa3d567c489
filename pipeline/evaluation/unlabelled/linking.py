"""Boxes of one object in frame after frame, for results whose objects have no track.

Not a tracker: nothing is smoothed, and no object is shown where none was found. Each chain expects its object where
constant velocity brings it. The boxes of a frame are then assigned, as many as possible, at the smallest sum of
distances.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, select_rows
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.evaluation.assignment import assign_nearest

MAX_GAP_FRAMES = 5
"""A chain ends after more frames without a box, or after `MAX_GAP_S`."""

MAX_GAP_S = 1.0

REACH_LENGTHS = 0.5
"""How far from where it is expected an object may be, in lengths of its class."""

UNKNOWN_LENGTHS_PER_S, KNOWN_LENGTHS_PER_S = 5.0, 1.0
"""Lengths added per second: while the object's velocity is not known (20 m/s for a car), and after that."""

OTHER_CLASS = 0.5
"""Cost of a change of class, in largest distances."""


@dataclass(frozen=True, slots=True, eq=False)
class _Ends:
    """The last box of each chain that may go on.

    Attributes:
        chains: (K,) int64, rising.
        stamps_ns: (K,) int64.
        frames: (K,) int64.
        xy: (K, 2) float64, metres.
        velocities: (K, 2) float64, metres a second; NaN for a chain of one box.
        class_ids: (K,) int64.
    """

    chains: I64
    stamps_ns: I64
    frames: I64
    xy: F64
    velocities: F64
    class_ids: I64


class Linker:
    """Gives the boxes of one source chains, frame by frame; `lengths_m` (C,) are those of the classes."""

    def __init__(self, lengths_m: F64) -> None:
        self._lengths_m = lengths_m
        self._count = 0
        none, place = np.zeros(0, np.int64), np.zeros((0, 2))
        self._ends = _Ends(none, none, none, place, place, none)

    def link(self, frame: int, boxes: Boxes3D, stamp_ns: int) -> I64:
        """The chain of each box (N,) of a frame; frames rise, and where time goes back all chains end."""
        ends = self._ends
        passed_s = (stamp_ns - ends.stamps_ns) / 1e9
        going_on = (passed_s > 0) & (passed_s <= MAX_GAP_S) & (frame - ends.frames <= MAX_GAP_FRAMES + 1)
        ends, passed_s = select_rows(ends, going_on), passed_s[going_on]
        xy, class_ids = boxes.centers[:, :2], boxes.class_ids.astype(np.int64)
        rows, columns = self._assigned(ends, passed_s, xy, class_ids)
        chains = np.full(len(xy), -1, np.int64)
        chains[columns] = ends.chains[rows]
        is_new = chains < 0
        chains[is_new] = self._count + np.arange(is_new.sum())
        self._count += int(is_new.sum())
        velocities = np.full((len(xy), 2), np.nan)
        velocities[columns] = (xy[columns] - ends.xy[rows]) / passed_s[rows, None]
        waiting = np.ones(len(ends.chains), np.bool_)
        waiting[rows] = False
        rest = select_rows(ends, waiting)
        here = np.full(len(xy), frame, np.int64), np.full(len(xy), stamp_ns, np.int64)
        joined = _Ends(
            np.concatenate([rest.chains, chains]),
            np.concatenate([rest.stamps_ns, here[1]]),
            np.concatenate([rest.frames, here[0]]),
            np.concatenate([rest.xy, xy]),
            np.concatenate([rest.velocities, velocities]),
            np.concatenate([rest.class_ids, class_ids]),
        )
        self._ends = select_rows(joined, np.argsort(joined.chains))
        return chains

    def _assigned(self, ends: _Ends, passed_s: F64, xy: F64, class_ids: I64) -> tuple[I64, I64]:
        """Rows of the chains and of the boxes that go on with them."""
        is_known = ~np.isnan(ends.velocities[:, 0])
        expected = ends.xy + np.where(is_known[:, None], ends.velocities * passed_s[:, None], 0.0)
        growth = np.where(is_known, KNOWN_LENGTHS_PER_S, UNKNOWN_LENGTHS_PER_S)
        reach_m = self._lengths_m[ends.class_ids] * (REACH_LENGTHS + growth * passed_s)
        away = np.linalg.norm(expected[:, None] - xy[None], axis=-1) / reach_m[:, None]
        rows, columns = np.nonzero(away < 1)
        costs = away[rows, columns] + OTHER_CLASS * (ends.class_ids[rows] != class_ids[columns])
        chosen = assign_nearest(rows, columns, costs)
        return rows[chosen], columns[chosen]
