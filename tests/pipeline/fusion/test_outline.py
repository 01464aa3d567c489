import numpy as np
import pytest

from pipeline.core.arrays import F64
from pipeline.fusion.outline import cuboid_outline, rounded_outline

CAR, BUS = [4.0, 1.8, 1.5], [12.0, 2.5, 3.2]


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


def test_the_underside_is_above_the_ground() -> None:
    assert points([CAR, BUS], underside=0.1)[..., 2].min(1).tolist() == pytest.approx([-0.6, -1.28])


def test_only_what_is_lower_than_wide_has_a_cabin() -> None:
    car, bus = points([CAR, BUS], cabin=0.4)
    assert np.abs(car[car[:, 2] > 0.7]).max(0).tolist() == pytest.approx([1.2, 0.54, 0.75])
    assert np.abs(car).max(0).tolist() == pytest.approx([2, 0.9, 0.75])
    assert np.abs(bus[bus[:, 2] > 1.5]).max(0).tolist() == pytest.approx([6, 1.25, 1.6])


def test_selection() -> None:
    outline = rounded_outline(np.array([CAR, BUS]), rounding=0.2, underside=0, cabin=0, bent=False)
    np.testing.assert_array_equal(outline.select(np.array([1])).offsets[0], outline.offsets[1])
    same = cuboid_outline(bent=False)
    assert same.select(np.array([0, 5])) is same
