import numpy as np
import pytest

from pipeline.core.arrays import F64
from pipeline.fusion.projection import cuboid_outline, rounded_outline

CAR, BUS, RIDER = [4.0, 1.8, 1.5], [12.0, 2.5, 3.2], [1.8, 0.6, 1.7]


def points(sizes: list[list[float]], **settings: float) -> F64:
    table = np.array(sizes)
    outline = rounded_outline(table, **{"rounding": 0.0, "underside": 0.0, "cabin": 0.0, **settings}, bent=False)
    found: F64 = outline.signs * table[:, None] / 2 + outline.offsets
    return found


def test_a_cuboid_has_its_corners() -> None:
    assert np.abs(cuboid_outline(bent=False).signs).tolist() == [[1, 1, 1]] * 8
    assert len(cuboid_outline(bent=True).signs) > 8


@pytest.mark.parametrize("bent", [False, True])
def test_without_rounding_the_outline_is_the_box(bent: bool) -> None:
    sizes = np.array([CAR, BUS])
    outline = rounded_outline(sizes, rounding=0, underside=0, cabin=0, bent=bent)
    assert not outline.offsets.any()
    assert {tuple(row) for row in cuboid_outline(bent=False).signs.tolist()} <= {
        tuple(r) for r in outline.signs.tolist()
    }


def test_round_corners_are_seen_across_as_far_inside_as_circles_are() -> None:
    found = points([CAR], rounding=0.25)[0]
    np.testing.assert_allclose(np.abs(found).max(0), [2, 0.9, 0.75])  # along its axes the box is as large as before
    across = (found[:, :2] @ np.array([1, 1]) / np.sqrt(2)).max()
    radius = 0.25 * 1.8
    assert across == pytest.approx((2 - radius + 0.9 - radius) / np.sqrt(2) + radius)


def test_people_are_round() -> None:
    person = points([[0.6, 0.6, 1.75]], rounding=0.25)[0]
    assert (person[:, :2] @ np.array([1, 1]) / np.sqrt(2)).max() == pytest.approx(0.3)
    assert np.abs(points([[0.6, 0.6, 1.75]])[0]).min(0).tolist() == pytest.approx([0.3, 0.3, 0.175])


def test_buses_have_sharper_corners_than_cars() -> None:
    cut = [one[1] / 2 - np.abs(found[found[:, 0] == one[0] / 2][:, 1]).max() for one, found in pairs(CAR, BUS)]
    assert cut[1] / BUS[1] == pytest.approx(0.4 * cut[0] / CAR[1])


def pairs(*sizes: list[float]) -> list[tuple[list[float], F64]]:
    return [(one, points([one], rounding=0.25)[0]) for one in sizes]


def test_who_rides_is_broad_in_the_middle_and_has_thin_wheels_and_one_head() -> None:
    rider = points([RIDER], rounding=0.25, underside=0.06)[0]
    half = np.array(RIDER) / 2
    assert np.abs(rider).max(0).tolist() == pytest.approx(half.tolist())  # none of its sides is nearer
    assert (np.abs(rider) <= half + 1e-12).all()
    for flip in ([1, -1, 1], [-1, 1, 1]):  # front and rear, left and right alike
        assert {*map(tuple, np.round(rider * flip, 9).tolist())} == {*map(tuple, np.round(rider, 9).tolist())}
    ends = rider[np.abs(rider[:, 0]) > 0.9 * half[0]]
    assert (np.abs(ends[:, 1]) <= 0.03 + 1e-12).all()
    assert (ends[:, 2] < 0).all()
    hands = rider[np.abs(rider[:, 1]) > 0.9 * half[1]]
    assert (np.abs(hands[:, 0]) < 0.3 * half[0]).all()
    top, ground = rider[rider[:, 2] > 0.9 * half[2]], rider[rider[:, 2] < -0.9 * half[2]]
    assert (np.abs(top[:, :2]) < [0.2, 0.1]).all()
    assert ground[:, 2].min() == pytest.approx(-half[2])
    assert np.abs(ground[:, 0]).max() == pytest.approx(0.6 * half[0])


def test_a_rider_without_rounding_is_a_box() -> None:
    assert np.abs(points([RIDER])[0]).min(0).tolist() == pytest.approx([0.9, 0.3, 0.17])


def test_the_underside_is_above_the_ground() -> None:
    assert points([CAR, BUS], underside=0.1)[..., 2].min(1).tolist() == pytest.approx([-0.6, -1.28])


def test_only_what_is_lower_than_wide_has_a_cabin() -> None:
    car, bus = points([CAR, BUS], cabin=0.4)
    assert np.abs(car[car[:, 2] > 0.7]).max(0).tolist() == pytest.approx([1.2, 0.54, 0.75])
    assert np.abs(car).max(0).tolist() == pytest.approx([2, 0.9, 0.75])
    assert np.abs(bus[bus[:, 2] > 1.5]).max(0).tolist() == pytest.approx([6, 1.25, 1.6])
