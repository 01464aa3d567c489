"""Classes by size in one pass, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.naming_kernels import size_log_odds

from pipeline.core.arrays import F64, Bools

LONG_LIMIT, SHORT_SHARE, SHORT_LIMIT, MEASURED_SHARE, OWN = LIMITS = np.array([4.0, 0.2, 3.0, 1e-3, 0.2])
WEIGHTS = np.array([[0.15, 0.15, 0.2], [0.15, 0.15, 0.9]])
OF_CLASS = np.array([0, 0, 1, 2, 2])
TURNED = [1, 0, 2]


def fit(extent: F64, is_measured: Bools, typical: F64, spread: F64) -> F64:
    long = np.minimum(np.maximum(extent - typical, 0) / np.maximum(spread, 1e-9), LONG_LIMIT) * is_measured
    short = np.minimum(np.maximum(typical - extent, 0) / (SHORT_SHARE * typical), SHORT_LIMIT)
    weights = np.where(is_measured, WEIGHTS[1], WEIGHTS[0])
    return np.asarray(-(long**2 + weights * short**2).sum(2) / 2)


@pytest.mark.parametrize("count", [0, 1, 200])
def test_log_odds(count: int) -> None:
    random = np.random.default_rng(count)
    typical, spread = random.uniform(0.5, 9, (5, 3)), random.uniform(0.1, 1, (5, 3))
    sizes, own_ids = random.uniform(0.3, 10, (count, 3)), random.integers(0, 3, count).astype(np.int32)
    completed = random.random((count, 3)) < 0.4
    sizes = np.where(completed, typical[np.searchsorted(OF_CLASS, own_ids)], sizes)
    found = size_log_odds(sizes, own_ids, typical, spread, OF_CLASS, WEIGHTS, LIMITS, 3)

    extent, own = sizes[:, None], own_ids[:, None] == OF_CLASS
    is_typical = np.abs(extent - typical) <= MEASURED_SHARE * typical
    is_measured = ~(is_typical & own[..., None]).any(1)[:, None]
    of_kinds = fit(extent, is_measured, typical, spread)
    has_one_side = (is_measured[..., 0] != is_measured[..., 1]) & ~own
    turned = fit(extent[..., TURNED], is_measured[..., TURNED], typical, spread)
    of_kinds = np.where(has_one_side, np.maximum(of_kinds, turned), of_kinds)
    odds = np.maximum.reduceat(of_kinds, [0, 2, 3], axis=1)
    odds[np.arange(count), own_ids] += OWN
    np.testing.assert_array_equal(found, odds)
    assert count < 200 or has_one_side.any()
