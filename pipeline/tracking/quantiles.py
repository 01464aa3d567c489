"""Weighted quantiles of groups, such as the sightings of tracks."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64


def quantiles(values: F64, weights: F64, groups: I64, count: int, share: float) -> F64:
    """(G,) weighted quantile of the values (N,) of each group; NaN of a group without weight."""
    order = np.lexsort((values, groups))
    values, weights, groups = values[order], weights[order], groups[order]
    total = np.bincount(groups, weights, count)
    starts = np.searchsorted(groups, np.arange(count))
    sums = np.cumsum(weights)
    before = np.concatenate([[0.0], sums])[starts]
    reached = sums - before[groups] >= share * total[groups] * (1 - 1e-12)
    found = np.full(count, np.nan)
    first = np.flatnonzero(reached & (total[groups] > 0))[::-1]
    found[groups[first]] = values[first]
    return found
