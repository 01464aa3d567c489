"""The sums over pairs in one pass, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.matching.agreement_kernels import distances_of_pairs, shifts_of_others, sums_of_others

FREEDOM = 4.0
BOXES, VIEWS, CLASSES = 6, 14, 5
random = np.random.default_rng(5)
JACOBIANS, NOISE = random.normal(0, 20, (VIEWS, 4, 3)), random.uniform(1, 9, (VIEWS, 4))
CAMERAS, ROWS = np.sort(random.integers(0, 4, VIEWS)), random.integers(0, BOXES, VIEWS)
ROOT = random.normal(0, 0.3, (VIEWS, 3, 3))
COVARIANCES = ROOT @ ROOT.swapaxes(1, 2)


@pytest.mark.parametrize("count", [0, 1, 40])
def test_distances(count: int) -> None:
    rng = np.random.default_rng(count)
    seen, differences = np.sort(rng.integers(0, VIEWS, count)), rng.normal(0, 10, (count, 4))
    moves, shifts, aims = rng.normal(size=(VIEWS, 3)), rng.normal(size=(VIEWS, 2)), rng.uniform(1, 5, (VIEWS, 2))
    found = distances_of_pairs(seen, differences, JACOBIANS, COVARIANCES, moves, NOISE, shifts, aims)
    plain = NOISE + np.einsum("pfa,pab,pfb->pf", JACOBIANS, COVARIANCES, JACOBIANS)
    moved = np.einsum("pfa,pa->pf", JACOBIANS, moves)
    off, variances = differences - moved[seen], plain[seen]
    away = off.copy()
    away[:, :2] -= shifts[seen]
    variances[:, :2] += aims[seen]
    expected = (away**2 / variances).sum(1), variances, off[:, :2], plain[seen, :2]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("count", [0, 1, 9])
def test_shifts_by_the_others_of_a_camera(count: int) -> None:
    rng = np.random.default_rng(count)
    matched, prior = rng.permutation(VIEWS)[:count], rng.uniform(4, 30, (VIEWS, 2))
    away, variances, squared = rng.normal(0, 9, (count, 2)), rng.uniform(2, 9, (count, 2)), rng.uniform(0, 30, count)
    found = shifts_of_others(CAMERAS, prior, matched, away, variances, squared, FREEDOM)
    weights = ((FREEDOM + 4) / (FREEDOM + squared))[:, None] / variances
    own = np.concatenate([weights, weights * away], 1)
    total = np.zeros((CAMERAS.max() + 1, 4))
    np.add.at(total, CAMERAS[matched], own)
    others = total[CAMERAS]
    others[matched] -= own
    left = prior / (1 + prior * others[:, :2])
    for one, other in zip(found, (left * others[:, 2:], left), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("count", [0, 1, 9])
def test_sums_of_the_other_cameras(count: int) -> None:
    rng = np.random.default_rng(count)
    matched, ids = rng.permutation(VIEWS)[:count], rng.integers(0, CLASSES, count).astype(np.int32)
    differences, noise, squared = rng.normal(size=(count, 4)), rng.uniform(1, 9, (count, 4)), rng.uniform(0, 30, count)
    information, log_classes = rng.normal(size=(BOXES, 3, 3)), rng.normal(size=(BOXES, CLASSES))
    log_confusion, slopes = rng.normal(size=(CLASSES, CLASSES)), JACOBIANS[matched]
    found = sums_of_others(
        ROWS, information, log_classes, log_confusion, matched, ids, differences, noise, squared, slopes, FREEDOM
    )
    weights = (FREEDOM + 4) / (FREEDOM + squared)[:, None] / noise
    own_normal = np.einsum("tfa,tf,tfb->tab", slopes, weights, slopes)
    own_pull = np.einsum("tfa,tf,tf->ta", slopes, weights, differences)
    expected = []
    for own in (own_normal, own_pull, log_confusion.T[ids]):
        total = np.zeros((BOXES, *own.shape[1:]))
        np.add.at(total, ROWS[matched], own)
        others = total[ROWS]
        others[matched] -= own
        expected.append(others)
    normal, pull, log_others = expected
    for one, other in zip(found, (information[ROWS] + normal, pull, log_classes[ROWS] + log_others), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)
