"""Shapely is the judge: a general engine for polygons, which knows nothing of boxes."""

import numpy as np
import pytest
import shapely
from helpers import at_most
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.rotated_iou import BoxArrays, Ious, ious, pair_ious, shared_ground

Row = tuple[float, float, float, float, float, float, float]
TOLERANCE = 1e-9


def boxes(*rows: Row) -> BoxArrays:
    """From rows of x, y, z, length, width, height, yaw."""
    table = np.array(rows, np.float64).reshape(-1, 7)
    return BoxArrays(table[:, :3], table[:, 3:6], table[:, 6])


def random_boxes(rng: np.random.Generator, count: int, spread_m: float = 3.0) -> BoxArrays:
    centers, sizes = rng.uniform(-spread_m, spread_m, (count, 3)), rng.uniform(0.1, 6, (count, 3))
    return BoxArrays(centers, sizes, rng.uniform(-4, 4, count))


def judged(first: BoxArrays, second: BoxArrays) -> Ious:
    """IoU of pairs, by shapely; every box has an extent."""
    a, b = (shapely.polygons(box_corners(*each)[:, :4, :2]) for each in (first, second))
    shared = shapely.area(shapely.intersection(a, b))
    ground_a, ground_b = shapely.area(a), shapely.area(b)
    low = np.maximum(first.centers[:, 2] - first.sizes[:, 2] / 2, second.centers[:, 2] - second.sizes[:, 2] / 2)
    high = np.minimum(first.centers[:, 2] + first.sizes[:, 2] / 2, second.centers[:, 2] + second.sizes[:, 2] / 2)
    volume = shared * np.maximum(high - low, 0)
    return Ious(
        shared / (ground_a + ground_b - shared),
        volume / (ground_a * first.sizes[:, 2] + ground_b * second.sizes[:, 2] - volume),
    )


def assert_as_judged(first: BoxArrays, second: BoxArrays, within: float = TOLERANCE) -> None:
    found, expected = pair_ious(first, second), judged(first, second)
    np.testing.assert_allclose(found.bev, expected.bev, rtol=0, atol=within)
    np.testing.assert_allclose(found.volume, expected.volume, rtol=0, atol=within)


STEPS = st.integers(-3, 3).map(float)
EXTENTS = st.sampled_from([0.01, 0.5, 1.0, 2.0, 3.0, 100.0])
TURNS = st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi, -np.pi, np.pi / 4, 3 * np.pi, 0.3, 1e-9])
ON_A_GRID = st.tuples(STEPS, STEPS, STEPS, EXTENTS, EXTENTS, EXTENTS, TURNS)


@given(first=ON_A_GRID, second=ON_A_GRID, turn=st.floats(-4, 4))
@settings(max_examples=100, derandomize=True)
def test_edges_and_corners_that_meet(first: Row, second: Row, turn: float) -> None:
    """On a grid, boxes are often equal, inside of one another, or touch."""
    assert_as_judged(boxes(first), boxes(second))
    cos, sin = np.cos(turn), np.sin(turn)
    T = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    a, b = (BoxArrays(box.centers @ T, box.sizes, box.yaws + turn) for box in (boxes(first), boxes(second)))
    np.testing.assert_allclose(pair_ious(a, b), pair_ious(boxes(first), boxes(second)), rtol=0, atol=TOLERANCE)


CAR: Row = (10, 20, 1, 4, 2, 1.5, 0.3)


@pytest.mark.parametrize(
    "second",
    [
        pytest.param((2, 0, 0, 2, 2, 2, 0), id="edge"),
        pytest.param((2, 2, 0, 2, 2, 2, 0), id="corner"),
        pytest.param((0, 0, 2, 2, 2, 2, 0), id="face"),
        pytest.param((1 + 2**0.5, 0, 0, 2, 2, 2, np.pi / 4), id="corner on an edge"),
        pytest.param((0, 5, 0, 2, 2, 2, 0.1), id="apart"),
    ],
)
def test_boxes_that_touch_share_nothing_at_all(second: Row) -> None:
    """Some figures divide by sums of IoUs: a remainder of rounding in place of zero would count like an overlap."""
    found = pair_ious(boxes((0, 0, 0, 2, 2, 2, 0)), boxes(second))
    assert found.volume.tolist() == [0.0]
    assert found.bev.tolist() == [1.0 if second[2] else 0.0]


def test_sites_in_utm_coordinates() -> None:
    rng = np.random.default_rng(2)
    first, second = random_boxes(rng, 500), random_boxes(rng, 500)
    utm = np.array([5e5, 5.4e6, 300.0])
    there = [BoxArrays(box.centers + utm, box.sizes, box.yaws) for box in (first, second)]
    np.testing.assert_allclose(pair_ious(*there), pair_ious(first, second), rtol=0, atol=1e-7)
    assert_as_judged(there[0], there[1], within=1e-6)


@pytest.mark.parametrize(
    ("row", "bev"),
    [
        pytest.param((10, 20, 1, 0, 2, 1.5, 0.3), 0, id="no length"),
        pytest.param((10, 20, 1, 4, 0, 1.5, 0.3), 0, id="no width"),
        pytest.param((10, 20, 1, 4, 2, 0, 0.3), 1, id="no height"),
        pytest.param((10, 20, 1, 0, 0, 0, 0.3), 0, id="a point"),
        pytest.param((10, 20, 1, -4, -2, 1.5, 0.3), 0, id="inside out"),
        pytest.param((10, 20, 1, 4, 2, -1.5, 0.3), 1, id="upside down"),
        pytest.param((np.nan, 20, 1, 4, 2, 1.5, 0.3), 0, id="centre not a number"),
        pytest.param((10, 20, np.inf, 4, 2, 1.5, 0.3), 1, id="infinitely high"),
        pytest.param((10, 20, 1, np.inf, 2, 1.5, 0.3), 0, id="infinite"),
        pytest.param((10, 20, 1, 4, 2, np.nan, 0.3), 1, id="height not a number"),
        pytest.param((10, 20, 1, 4, 2, 1.5, np.inf), 0, id="infinite yaw"),
        pytest.param((10, 20, 1, 1e200, 1e200, 1e200, 0.3), 0, id="too large to have an area"),
        pytest.param((10, 20, 1, 1e-200, 1e-200, 1e-200, 0.3), 0, id="too small to have an area"),
    ],
)
def test_what_is_no_box_has_no_overlap(row: Row, bev: float) -> None:
    for first, second in ((CAR, row), (row, CAR), (row, row)):
        for found in (pair_ious(boxes(first), boxes(second)), ious(boxes(first), boxes(second))):
            assert found.bev.ravel().tolist() == pytest.approx([bev], abs=1e-12)
            assert found.volume.ravel().tolist() == [0.0]


def test_each_with_each_is_what_pairs_are() -> None:
    rng = np.random.default_rng(3)
    first, second = random_boxes(rng, 40, spread_m=12), random_boxes(rng, 25, spread_m=12)
    found = ious(first, second)
    rows, columns = np.divmod(np.arange(40 * 25), 25)
    a, b = (BoxArrays(box.centers[at], box.sizes[at], box.yaws[at]) for box, at in ((first, rows), (second, columns)))
    np.testing.assert_array_equal(found.bev.ravel(), pair_ious(a, b).bev)
    np.testing.assert_array_equal(found.volume.ravel(), pair_ious(a, b).volume)
    assert 0.02 < (found.bev > 0).mean() < 0.5


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 3), (3, 0), (1, 1)])
def test_none_and_one(n: int, m: int) -> None:
    found = ious(boxes(*[CAR] * n), boxes(*[CAR] * m))
    assert found.bev.shape == found.volume.shape == (n, m)
    assert pair_ious(boxes(*[CAR] * n), boxes(*[CAR] * n)).bev.shape == (n,)


def test_shared_ground_is_in_square_metres() -> None:
    assert shared_ground(boxes(CAR), boxes((10, 20, 9, 2, 8, 1, 0.3))) == pytest.approx([4.0])


def test_memory_of_many_pairs_is_that_of_the_result() -> None:
    rng = np.random.default_rng(5)
    first, second = random_boxes(rng, 200_000), random_boxes(rng, 200_000)
    with at_most(8):
        shared_ground(
            first, second
        )  # the result takes 1.6 MB; the corners of all pairs at once, 13 MB for each of a dozen arrays
