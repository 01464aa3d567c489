"""How much a 2D detector finds of what it looks at: by size in the image, and learned from the run itself.

A camera that says nothing about an object speaks against it as far as it should have seen it. How far that is differs
between networks, between day and night, and between a clean and a dirty lens. So it is counted: objects that the other
sensors are sure of either have a 2D box in this camera or not. Until there are many of them, a prior stands in.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import F64, Indices
from pipeline.fusion.belief.odds import Coefficients, joined_without_each, probability
from pipeline.fusion.belief.visibility import Visibility

__all__ = ["RecallCounts"]


SIZE_EDGES_PX = (12.0, 24.0, 48.0, 96.0)
"""Sizes in the image, geometric means of width and height, between which recall is counted apart."""

_EDGES_PX = np.array(SIZE_EDGES_PX)

PRIOR_RECALL = (0.2, 0.45, 0.75, 0.9, 0.93)
"""Recall by size before anything is counted: between those of a small network and of the simulator's detector."""

PRIOR_WEIGHT = 20.0
"""So many objects weigh as much as the prior; the same for one camera against all cameras together."""

MEMORY = 400.0
"""Objects of one size that a camera remembers: older ones fade, so that night may follow day."""

SURE = 0.7
"""Objects are counted that are at least so probable without the camera."""

PLAIN_SHARE = 0.7
"""They are at least so far visible in its image."""


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
