import numpy as np
import numpy.typing as npt
import pytest

from lidcam.pipeline.core.geometry.polygons import clipped_polygon, first_polygon_with

LOW, HIGH = np.array([-2.0, -1.0]), np.array([3.0, 2.0])


@pytest.mark.parametrize(
    "corners",
    [
        [[-1, 0], [1, 0], [0, 1]],
        [[-1, 0], [0, 1], [1, 0]],  # the other way round
        [[-100, -100], [100, -100], [100, 100], [-100, 100]],  # all of it
        [[-100, 0], [100, 0], [100, 100], [-100, 100]],
        [[-9, -9], [9, -5], [0, 9]],  # slanted edges
        [[-9, 0], [9, -9], [1, 0], [9, 9]],  # concave
        [[5, 5], [6, 5], [5, 6]],  # nothing of it
    ],
)
def test_the_part_within_bounds(corners: npt.ArrayLike) -> None:
    polygon = np.array(corners, np.float64)
    clipped = clipped_polygon(polygon, LOW, HIGH)
    assert ((clipped >= LOW - 1e-9) & (clipped <= HIGH + 1e-9)).all()
    points = np.random.default_rng(1).uniform(-6, 6, (2000, 2))
    expected = (first_polygon_with([polygon], points) == 0) & ((points >= LOW) & (points <= HIGH)).all(1)
    found = first_polygon_with([clipped], points) == 0 if len(clipped) else np.zeros(len(points), np.bool_)
    np.testing.assert_array_equal(found, expected)
    assert len(clipped) or not expected.any()
