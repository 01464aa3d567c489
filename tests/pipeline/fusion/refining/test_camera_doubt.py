import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pipeline.fusion.refining.camera_doubt import MEDIAN_SPREAD, SURE, camera_shifts


@given(st.integers(0, 2**31), st.integers(0, 12), st.integers(1, 4))
def test_shifts_are_the_medians_that_are_sure(seed: int, pairs: int, cameras: int) -> None:
    random = np.random.default_rng(seed)
    rows, off = random.integers(cameras, size=pairs), random.normal(5, 3, (pairs, 2))
    variances = random.uniform(1, 20, (pairs, 2))
    found = camera_shifts(rows, off, variances, count=cameras)
    for camera in range(cameras):
        own, expected = rows == camera, np.zeros(2)
        if own.any():
            shift = np.median(off[own], axis=0)
            sigma = MEDIAN_SPREAD * np.sqrt(np.median(variances[own], axis=0) / own.sum())
            expected = np.where(np.abs(shift) > SURE * sigma, shift, 0.0)
        np.testing.assert_allclose(found[camera], expected, rtol=1e-12)


@pytest.mark.parametrize("count", [0, 3])
def test_nothing_matched(count: int) -> None:
    nothing = np.zeros((0, 2))
    np.testing.assert_array_equal(
        camera_shifts(np.zeros(0, np.int64), nothing, nothing, count=count), np.zeros((count, 2))
    )
