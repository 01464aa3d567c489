"""What cameras said a moment ago, for frames in which they do not look: cameras are often slower than lidars.

Without it an object that only cameras are sure of would come and go with every other frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from pipeline.core.arrays import F64, I32, Bools, Indices, join_rows, select_rows
from pipeline.core.detections import Boxes3D
from pipeline.core.settings.classes import ClassPrior

__all__ = ["Memory"]


HALF_LIFE_S = 0.3
"""In this time what was said comes to count half."""

MAX_AGE_S = 1.0
"""What was said longer ago does not count."""

SHORT_M = 1.0
"""What is shorter goes on foot."""

FOOT_MPS, WHEELS_MPS = 3.0, 15.0
"""How fast what goes on foot, and what has wheels, may move."""

SPREAD_SHARE = 0.1
"""Boxes of what stands still differ by this share of the length of its class."""

MAX_SIZE_RATIO = 3.0
"""No side of the same object is so many times as long in another frame: what is hidden of it changes."""

NEAR_M = 1e-6
"""Gates are at least so wide when distances are divided by them."""

NEVER = 1e6
"""Cost of a pair that cannot be one object."""


@dataclass(frozen=True, slots=True, eq=False)
class _Said:
    """(M) boxes that cameras looked at: age, place in the site frame as it stands now, size, class, evidence."""

    age_s: F64
    centers: F64
    sizes: F64
    class_ids: I32
    evidence: F64


class Memory:
    """What cameras said last about each object. Frames must come in order."""

    def __init__(self, priors: Sequence[ClassPrior]) -> None:
        length_m = np.array([prior.size_m[0] for prior in priors])
        self._speed_mps = np.where(length_m < SHORT_M, FOOT_MPS, WHEELS_MPS)
        self._spread_m = SPREAD_SHARE * length_m
        self._said = _Said(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int32), np.zeros(0))

    def age(self, seconds: float, T_now_then: F64 | None) -> None:
        """Go on to the next frame.

        Args:
            seconds: Time since the last one.
            T_now_then: (4, 4) from the site frame as it stood then to as it stands now; None if that is not known,
                then all is forgotten.
        """
        said, age_s = self._said, self._said.age_s + seconds
        keep = (age_s >= 0) & (age_s <= MAX_AGE_S) & (T_now_then is not None)
        T = np.eye(4) if T_now_then is None else T_now_then
        x, y, z = said.centers.T[:, :, None]
        centers = x * T[:3, 0] + y * T[:3, 1] + z * T[:3, 2] + T[:3, 3]
        self._said = select_rows(_Said(age_s, centers, said.sizes, said.class_ids, said.evidence), keep)

    def recalled(self, boxes: Boxes3D, is_asked: Bools) -> F64:
        """(N,) log likelihood ratios that are remembered of N boxes; 0 for those that are not asked for."""
        evidence, asked = np.zeros(len(boxes)), is_asked.nonzero()[0]
        if not len(asked):
            return evidence
        rows, said = self._same(boxes.select(asked))
        faded = self._said.evidence * 0.5 ** (self._said.age_s / HALF_LIFE_S)
        evidence[asked[rows]] = faded[said]
        return evidence

    def remember(self, boxes: Boxes3D, is_seen: Bools, evidence: F64, *, all_look: bool) -> None:
        """Keep what cameras say in this frame, in place of what they said of the same objects.

        Args:
            boxes: N boxes.
            is_seen: (N,) whether a camera looks at each.
            evidence: (N,) log likelihood ratio of what they say.
            all_look: Whether no camera is silent: then nothing older is kept.
        """
        seen = is_seen.nonzero()[0]
        new = _Said(np.zeros(len(seen)), boxes.centers[seen], boxes.sizes[seen], boxes.class_ids[seen], evidence[seen])
        if not all_look:
            keep = np.ones(len(self._said.age_s), np.bool_)
            keep[self._same(boxes.select(seen))[1]] = False
            new = join_rows(new, select_rows(self._said, keep))
        self._said = new

    def _same(self, boxes: Boxes3D) -> tuple[Indices, Indices]:
        """Rows of boxes and of what was said that are one object, each at most once: the nearest of the same class."""
        said = self._said
        apart_m = np.sqrt(((boxes.centers[:, None, :2] - said.centers[:, :2]) ** 2).sum(2))
        gate_m = self._spread_m[said.class_ids] + self._speed_mps[said.class_ids] * said.age_s
        ratio = np.abs(np.log(boxes.sizes[:, None] / said.sizes)).max(2)
        same_class = boxes.class_ids[:, None] == said.class_ids
        fits = (apart_m <= gate_m) & (ratio <= np.log(MAX_SIZE_RATIO)) & same_class
        rows, of = linear_sum_assignment(np.where(fits, apart_m / np.maximum(gate_m, NEAR_M), NEVER))
        is_one = fits[rows, of]
        return rows[is_one], of[is_one]
