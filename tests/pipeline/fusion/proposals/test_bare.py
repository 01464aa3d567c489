"""Bare ground below objects that only cameras place."""

import numpy as np
import pytest
from detections import boxes3d

from lidcam.pipeline.core.arrays import F32, Bools
from lidcam.pipeline.fusion.proposals.bare import bare_shares

SIDE = np.arange(-15, 15, 0.1)
GROUND = np.stack([*np.meshgrid(SIDE, SIDE), np.zeros((len(SIDE), len(SIDE)))], 2).reshape(-1, 3).astype(np.float32)
X, Y = GROUND[:, 0], GROUND[:, 1]
CAR = (2.0, 1.0, 0.75, 4.2, 1.8, 1.5, 0.3)


def shares(ground: F32, *rows: tuple[float, ...], sigma_x_m: float = 0.1) -> list[float]:
    return [*bare_shares(boxes3d(rows, deviations=(sigma_x_m, 0.1, 0.1)), ground)]


@pytest.mark.parametrize(
    ("keep", "sigma_x_m", "share"),
    [
        (np.inf > X, 0.1, 1),
        (np.inf < X, 0.1, 0),  # empty
        (np.hypot(X - 2, Y - 1) > 1.2, 0.1, 0),  # something hides it
        (np.hypot(X - 2, Y - 1) > 0.6, 0.1, 0),  # beams pass below its edges
        (X < 2, 3.0, 0.5),  # its distance is unknown
        (X < 2 - 3, 3.0, 0.16),
    ],
)
def test_share_of_the_places_where_the_ground_is_seen(keep: Bools, sigma_x_m: float, share: float) -> None:
    assert shares(GROUND[keep], CAR, sigma_x_m=sigma_x_m) == pytest.approx([share], abs=0.08)


def test_each_object_has_its_own_places() -> None:
    ground = GROUND[np.hypot(X - 2, Y - 1) > 1.2]
    assert shares(ground) == []
    assert shares(ground, CAR, (-6.0, 3.0, *CAR[2:]), CAR) == [0, 1, 0]


def test_a_few_points_are_no_bare_ground() -> None:
    below = np.array([[2.0, 1.0, 0.0], [2.1, 1.1, 0.0]], np.float32)
    assert shares(below, CAR) == [0]
