"""Rotations are those of scipy; the covariance of clusters is that of repeated experiments."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidcam.pipeline.calibration.motions import jackknife_covariance, motion
from lidcam.pipeline.core.geometry.rotations import turned


def test_rotations_are_those_of_scipy() -> None:
    vectors = np.random.default_rng(0).normal(0, 1, (20, 3))
    vectors[0] = 0
    np.testing.assert_allclose(turned(vectors), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-8)
    matrix = motion(np.arange(7.0))
    np.testing.assert_allclose(matrix[:3, :3], Rotation.from_rotvec([0, 1, 2]).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(matrix[:, 3], [3, 4, 5, 1])


@pytest.mark.parametrize("alike", [1, 10])
def test_errors_that_are_alike_count_once(alike: int) -> None:
    """The mean of 400 values in groups with one error each: its variance is that of as many values as groups."""
    random = np.random.default_rng(1)
    groups = np.repeat(np.arange(400 // alike), alike)
    away = random.normal(0, 1, 400 // alike)[groups]
    scores = (away - away.mean())[:, None]
    found = jackknife_covariance(scores, np.ones((400, 1, 1)), groups[:, None], np.array([[400.0]]), np.zeros(1))
    assert found[0, 0] == pytest.approx(alike / 400, rel=0.4)


@pytest.mark.parametrize(("groups", "highest"), [(4, 3.0), (40, 1.3)])
def test_a_line_through_few_groups_is_as_uncertain_as_repeated_experiments_show(groups: int, highest: float) -> None:
    random, alike = np.random.default_rng(2), 10
    rows, group = np.repeat(np.linspace(-1, 1, groups), alike), np.repeat(np.arange(groups), alike)[:, None]
    slopes = np.stack([np.ones(len(rows)), rows], 1)
    normal, each = slopes.T @ slopes, slopes[:, :, None] * slopes[:, None]
    values, found = [], []
    for _ in range(400):
        measured = np.repeat(random.normal(0, 1, groups), alike) + random.normal(0, 0.2, len(rows))
        values.append(np.linalg.solve(normal, slopes.T @ measured))
        scores = slopes * (measured - slopes @ values[-1])[:, None]
        found.append(jackknife_covariance(scores, each, group, normal, np.zeros(2)))
    ratios = np.diag(np.mean(found, 0)) / np.var(values, 0)
    assert ratios.min() > 0.9
    assert ratios.max() < highest
