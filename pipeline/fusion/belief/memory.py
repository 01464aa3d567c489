"""Memory of a run about its cameras: how much each of them finds, and the evidence that they gave a moment ago.

A camera that says nothing about an object speaks against it as far as it should have seen it. How far that is differs
between networks, between day and night, and between a clean and a dirty lens. So it is counted: objects that the other
sensors are sure of either have a 2D box in this camera or not. Until there are many of them, a prior stands in.

Cameras are often slower than lidars. In frames without their images, the evidence that they gave last counts for a
while: else an object that only cameras are sure of would come and go with every other frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, Bools, Indices, join_rows, select_rows
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.fusion.assignment import assign
from lidcam.pipeline.fusion.belief.odds import Coefficients, joined_without_each, probability
from lidcam.pipeline.fusion.belief.visibility import Visibility

SIZE_EDGES_PX = (12.0, 24.0, 48.0, 96.0)
"""Sizes in the image, geometric means of width and height, between which recall is counted apart."""

_EDGES_PX = np.array(SIZE_EDGES_PX)

PRIOR_RECALL = (0.2, 0.45, 0.75, 0.9, 0.93)
"""Recall by size before anything is counted: between those of a small network and of the simulator's detector."""

PRIOR_WEIGHT = 20.0
"""Weight of the prior in objects; also that of all cameras together against one camera."""

MEMORY = 400.0
"""Objects of one size that a camera remembers: older ones fade, so that night may follow day."""

SURE = 0.7
"""Objects are counted that are at least so probable without the camera."""

PLAIN_SHARE = 0.7
"""They are at least so far visible in its image."""

HALF_LIFE_S = 0.3
"""Time in which the weight of evidence halves."""

MAX_AGE_S = 1.0
"""Older evidence does not count."""

SHORT_M = 1.0
"""Classes of a smaller length go on foot."""

FOOT_MPS, WHEELS_MPS = 3.0, 15.0
"""Largest speeds on foot and on wheels."""

SPREAD_SHARE = 0.1
"""Distance of two boxes of an object that stands still, as a share of the length of its class."""

MAX_SIZE_RATIO = 3.0
"""Largest ratio of the sides of one object in two frames: the hidden part of it changes."""

NEAR_M = 1e-6
"""Gates are at least so wide when distances are divided by them."""

NEVER = 1e6
"""Cost of a pair that cannot be one object."""


class RecallCounts:
    """Counts of found and missed objects by camera and size.

    Args:
        cameras: Names of the cameras.
        plain_recall: Recall of large objects in plain view, in place of what is learned; None to learn.
    """

    def __init__(self, cameras: Sequence[str], plain_recall: float | None = None) -> None:
        self._rows = {name: row for row, name in enumerate(cameras)}
        self._seen = np.zeros((len(cameras), len(PRIOR_RECALL)))
        self._found = np.zeros_like(self._seen)
        self._fixed = None if plain_recall is None else np.array(PRIOR_RECALL) * (plain_recall / PRIOR_RECALL[-1])

    def plain(self, visibility: Visibility) -> F64:
        """(C, N) share of objects of the size of each box that each camera finds in plain view, as known so far."""
        rows = np.array([self._rows[name] for name in visibility.cameras], np.intp)
        return np.asarray(self._table()[rows[:, None], _bins(visibility.size_px)])

    def learn(self, visibility: Visibility, before: F64, evidence: F64, by: Coefficients) -> None:
        """Count what each camera finds and misses of what the other sensors are sure of.

        Args:
            visibility: How C cameras see N boxes.
            before: (N,) log odds of the boxes before a camera was asked.
            evidence: (C, N) log likelihood ratios of what the cameras say.
            by: The coefficients with which they are joined.
        """
        rows = np.array([self._rows[name] for name in visibility.cameras], np.intp)
        others = probability(before + joined_without_each(evidence, by))
        is_plain = visibility.in_view & ~visibility.is_cut & (visibility.visible >= PLAIN_SHARE)
        counted = (is_plain & (others >= SURE)).nonzero()
        cells, weights = rows[counted[0]] * len(PRIOR_RECALL) + _bins(visibility.size_px[counted]), others[counted]
        self._seen += np.bincount(cells, weights, self._seen.size).reshape(self._seen.shape)
        self._found += np.bincount(cells, weights * visibility.is_matched[counted], self._found.size).reshape(
            self._seen.shape
        )
        kept = MEMORY / np.maximum(self._seen, MEMORY)
        self._seen *= kept
        self._found *= kept

    def _table(self) -> F64:
        """(cameras, sizes) recall."""
        if self._fixed is not None:
            return np.broadcast_to(self._fixed, self._seen.shape)
        of_all = self._found.sum(0) + PRIOR_WEIGHT * np.array(PRIOR_RECALL)
        of_all /= self._seen.sum(0) + PRIOR_WEIGHT
        return np.asarray((self._found + PRIOR_WEIGHT * of_all) / (self._seen + PRIOR_WEIGHT))


def _bins(size_px: F64) -> Indices:
    return _EDGES_PX.searchsorted(size_px, side="right")


@dataclass(frozen=True, slots=True, eq=False)
class _Said:
    """(M) boxes that cameras saw: age, place in the site frame as it stands now, size, class, evidence."""

    age_s: F64
    centers: F64
    sizes: F64
    class_ids: I32
    evidence: F64


class Memory:
    """The last evidence of cameras about each object. Frames must come in order."""

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
        """Keep the evidence of this frame, in place of earlier evidence about the same objects.

        Args:
            boxes: N boxes.
            is_seen: (N,) whether a camera looks at each.
            evidence: (N,) log likelihood ratio.
            all_look: Whether all cameras have images in this frame: then nothing older is kept.
        """
        seen = is_seen.nonzero()[0]
        new = _Said(np.zeros(len(seen)), boxes.centers[seen], boxes.sizes[seen], boxes.class_ids[seen], evidence[seen])
        if not all_look:
            keep = np.ones(len(self._said.age_s), np.bool_)
            keep[self._same(boxes.select(seen))[1]] = False
            new = join_rows(new, select_rows(self._said, keep))
        self._said = new

    def _same(self, boxes: Boxes3D) -> tuple[Indices, Indices]:
        """Rows of boxes and of remembered boxes that are one object, each at most once: the nearest of one class."""
        said = self._said
        apart_m = np.sqrt(((boxes.centers[:, None, :2] - said.centers[:, :2]) ** 2).sum(2))
        gate_m = self._spread_m[said.class_ids] + self._speed_mps[said.class_ids] * said.age_s
        ratio = np.abs(np.log(boxes.sizes[:, None] / said.sizes)).max(2)
        same_class = boxes.class_ids[:, None] == said.class_ids
        fits = (apart_m <= gate_m) & (ratio <= np.log(MAX_SIZE_RATIO)) & same_class
        rows, of = assign(np.where(fits, apart_m / np.maximum(gate_m, NEAR_M), NEVER))
        is_one = fits[rows, of]
        return rows[is_one], of[is_one]
