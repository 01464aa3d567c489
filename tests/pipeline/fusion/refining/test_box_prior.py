from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from detections import boxes3d
from hypothesis import example, given
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.refining.box_prior import box_prior, known_covariances

LIDARS = np.array([[0.0, 0.0, 2.0], [3.0, -1.0, 2.0]])


def with_covariances(seed: int, count: int = 6) -> Boxes3D:
    random = np.random.default_rng(seed)
    rows = random.uniform([-30, -30, 0, 0.3, 0.3, 0.3, -3], [30, 30, 1, 12, 3, 3, 3], (count, 7))
    roots = random.normal(size=(count, 3, 3)) * random.uniform(0.01, 1, (count, 3, 1))
    boxes = boxes3d(rows)
    fields = {name: getattr(boxes, name) for name in Boxes3D.__slots__}
    sources = random.integers(0, 3, count).astype(np.uint8)
    return Boxes3D(**{**fields, "covariances": roots @ roots.transpose(0, 2, 1), "sources": sources})


@given(st.integers(0, 2**31), st.sampled_from([0.0, 0.15, 1.0]))
@example(1436436, 0.0)  # the centre is known along the box better than the least variance of the length allows for
def test_covariances_are_regular_whatever_the_boxes_say(seed: int, max_size_share: float) -> None:
    with patch("lidcam.pipeline.fusion.refining.box_prior.MAX_SIZE_SIGMA", max_size_share):
        prior = box_prior(with_covariances(seed), LIDARS, FuseConfig())
    scale = np.sqrt(np.einsum("nii->ni", prior.covariances))
    assert (np.linalg.eigvalsh(prior.covariances / scale[:, :, None] / scale[:, None]) > 0).all()
    assert np.isfinite(prior.information).all()
    assert ((prior.yaw_shares > 0) & (prior.yaw_shares <= 1)).all()


def test_the_scale_of_the_lidars_is_not_that_of_boxes_by_cameras() -> None:
    boxes = boxes3d([[10.0, 0, 0, 2, 2, 2, 0]] * 3, deviations=[0.1, 0.1, 0.1])
    boxes = replace(boxes, sources=np.arange(3, dtype=np.uint8))
    stds = [np.sqrt(box_prior(boxes, LIDARS, FuseConfig(lidar_sigma_scale=s)).covariances[:, 1, 1]) for s in (1, 2)]
    np.testing.assert_allclose(stds[1] / stds[0], [2, 1, 2], rtol=0.05)


def test_a_longer_box_is_centred_farther_from_the_lidar() -> None:
    box = boxes3d([[10.0, 0, 0, 4, 2, 1.5, 0]], deviations=[0.4, 0.05, 0.02])
    covariance = box_prior(box, LIDARS[:1], FuseConfig()).covariances[0]
    assert covariance[0, 3] > 0.9 * np.sqrt(covariance[0, 0] * covariance[3, 3])
    assert abs(covariance[1, 3]) < 1e-12


def test_heights_are_known_where_lidars_look_down_on_the_tops() -> None:
    boxes = boxes3d([[x, 0, height / 2, 4, 2, height, 0] for x in (4, 40) for height in (1.0, 4.0)])
    covariances = box_prior(boxes, LIDARS, FuseConfig()).covariances
    shares = np.sqrt(covariances[:, 5, 5]) / boxes.sizes[:, 2]
    assert shares[0] == pytest.approx(0.02)
    assert 0.05 < shares[2] < 0.08
    np.testing.assert_allclose(shares[[1, 3]], 0.08)


@pytest.mark.parametrize("lidars", [LIDARS[:, :2], np.zeros((0, 2))])
def test_unknown_covariances(lidars: F64) -> None:
    boxes = boxes3d([[10.0, 0, 0, 4, 2, 1.5, 0], [5, 0, 0, 0.6, 0.6, 1.7, 0]], deviations=[0.0, 0.0, 0.0])
    car, person = np.sqrt(np.einsum("nii->ni", known_covariances(boxes, lidars)))
    assert car[0] > person[0]
    assert car[2] < person[2]
