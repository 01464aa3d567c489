from itertools import combinations

import numpy as np
import pytest

from lidcam.pipeline.core.arrays import F64
from lidcam.writers.labels_3d import labels_apart
from lidcam.writers.viewpoint import Viewpoint

FOV_Y_DEG, HEIGHT_PX = 55.0, 480.0
EYE = Viewpoint(np.array([-30.0, 2.0, 30.0]), np.array([0.0, 2.0, 0.0]), np.array([1.0, 0.0]))


def seen(places: F64) -> F64:
    """Pixels right of and above the middle of a usual view, as a camera at the eye has them."""
    ahead = (EYE.target - EYE.eye) / np.linalg.norm(EYE.target - EYE.eye)
    right = np.array([0.0, -1.0, 0.0])
    away = places - EYE.eye
    across = np.stack([away @ right, away @ np.cross(right, ahead)], 1) / (away @ ahead)[:, None]
    return np.asarray(across * HEIGHT_PX / 2 / np.tan(np.radians(FOV_Y_DEG) / 2))


@pytest.mark.parametrize(
    "xy",
    [
        [],
        [(0, 0)],
        [(0, 0), (0, 0)],
        [(0, 0), (0.5, 0.2), (1, 0), (1.5, -0.3), (2, 0)],
        [(25, y) for y in np.linspace(-3, 3, 12)],  # more than fit above
        [(-60, 0), (0, 0)],  # one behind the eye
    ],
)
def test_no_label_covers_another(xy: list[tuple[float, float]]) -> None:
    tops = np.array([(x, y, 1.5) for x, y in xy]).reshape(-1, 3)
    places = labels_apart(tops, ["car #12, 8.0 m/s"] * len(xy), EYE, FOV_Y_DEG)
    np.testing.assert_array_equal(places[:, :2], tops[:, :2])
    shown = places[tops[:, 0] > -30]
    np.testing.assert_array_equal(places[tops[:, 0] <= -30], tops[tops[:, 0] <= -30])
    for one, other in combinations(seen(shown), 2):
        x, y = np.abs(one - other)
        assert x > 100 or y >= 25.9
    assert (np.abs(seen(shown)[:, 1]) <= HEIGHT_PX / 2).all()


def test_the_nearest_label_stays_above_its_roof() -> None:
    tops = np.array([[3.0, 2.0, 1.5], [0.0, 2.0, 1.5]])
    far, near = seen(labels_apart(tops, ["a", "b"], EYE, FOV_Y_DEG)) - seen(tops)
    assert near[1] == pytest.approx(26.0)
    assert far[1] >= near[1]
