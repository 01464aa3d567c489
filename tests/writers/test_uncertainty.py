from dataclasses import replace

import numpy as np
from detections import boxes3d
from hypothesis import given
from hypothesis import strategies as st

from lidcam.writers.drawing import ELLIPSE_CORNERS as CORNERS
from lidcam.writers.drawing import ground_ellipses

FACTORS = st.floats(0.01, 10.0)


@given(st.tuples(FACTORS, st.floats(-10.0, 10.0), FACTORS))
def test_points_are_one_standard_deviation_away(factor: tuple[float, float, float]) -> None:
    along, shear, across = factor
    lower = np.array([[along, 0.0], [shear, across]])
    covariance = np.zeros((2, 3, 3))
    covariance[1, :2, :2] = lower @ lower.T
    boxes = replace(boxes3d([[0.0, 0, 0, 1, 1, 1, 0], [5.0, -3, 2, 4, 2, 1.5, 1]]), covariances=covariance)
    unknown, known = ground_ellipses(boxes)
    np.testing.assert_array_equal(unknown, np.tile([0.0, 0.0, -0.5], (CORNERS, 1)))
    away = np.linalg.solve(lower, (known[:, :2] - [5, -3]).T)
    np.testing.assert_allclose(np.linalg.norm(away, axis=0), 1.0, rtol=1e-6)
    np.testing.assert_allclose(known[:, 2], 2 - 0.75)
