import numpy as np
import pytest
import shapely
from detections import boxes3d
from helpers import at_most

from lidcam.pipeline.core.geometry import overlaps
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.overlaps import overlap_shares, without_overlaps
from lidcam.pipeline.core.geometry.rotated_iou import BoxArrays


def overlaps_by_pairs(boxes: BoxArrays) -> list[int]:
    """Greedy suppression, pair by pair, by shapely."""
    grounds = shapely.polygons(box_corners(*boxes)[:, :4, :2])
    kept: list[int] = []
    for row, ground in enumerate(grounds):
        others = grounds[kept]
        smaller_m2 = np.minimum(shapely.area(ground), shapely.area(others))
        if (shapely.area(shapely.intersection(ground, others)) <= overlaps.OVERLAP_SHARE * smaller_m2).all():
            kept.append(row)
    return kept


def scattered(count: int, spread_m: float) -> BoxArrays:
    rng = np.random.default_rng(count)
    centers, sizes = rng.uniform(-spread_m, spread_m, (count, 3)), rng.uniform(0.3, 6, (count, 3))
    return BoxArrays(centers, sizes, rng.uniform(-3, 3, count))


@pytest.mark.parametrize(("count", "spread_m"), [(0, 1), (1, 1), (2, 1), (60, 4), (60, 20), (90, 60)])
def test_overlaps_are_those_of_all_pairs(count: int, spread_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(overlaps, "BLOCK_BOXES", 16)
    boxes = scattered(count, spread_m)
    assert without_overlaps(boxes).tolist() == overlaps_by_pairs(boxes)


@pytest.mark.parametrize(
    ("ahead_m", "kept"),
    [
        pytest.param(0.0, [0], id="same place"),
        pytest.param(2.99, [0], id="more than a quarter"),
        pytest.param(3.01, [0, 1], id="less than a quarter"),
        pytest.param(4.0, [0, 1], id="end to end"),
    ],
)
def test_share_of_the_ground_that_two_boxes_may_have_in_common(ahead_m: float, kept: list[int]) -> None:
    yaw, width_m = 0.7, np.array([1.8, 30.0])  # the share is that of the smaller one
    centers = np.array([[0.0, 0.0, 1.0], [ahead_m * np.cos(yaw), ahead_m * np.sin(yaw), 5.0]])
    sizes = np.column_stack([[4.0, 4.0], width_m, [1.5, 1.5]])
    assert without_overlaps(BoxArrays(centers, sizes, np.full(2, yaw))).tolist() == kept


def test_thousands_of_boxes_are_compared_with_their_neighbours_only() -> None:
    boxes = scattered(8000, 400)
    with at_most(30):
        without_overlaps(boxes)  # 8000 boxes against 256 at a time: 67 MiB


def test_boxes_of_one_group_are_not_compared() -> None:
    centers = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [30.0, 0, 0]])
    boxes = BoxArrays(centers, np.full((4, 3), 2.0), np.zeros(4))
    assert without_overlaps(boxes, np.array([0, 0, 1, 1], np.intp)).tolist() == [0, 1, 3]
    assert without_overlaps(boxes, np.zeros(4, np.intp)).tolist() == [0, 1, 2, 3]
    assert without_overlaps(boxes, np.arange(4).astype(np.intp)).tolist() == [0, 3]


def test_share_is_that_of_the_smaller_box() -> None:
    big, small = (0, 0, 0, 10, 10, 1, 0), (4.5, 0, 0, 2, 1, 1, 0)
    shares = overlap_shares(boxes3d([big, (50, 0, 0, 1, 1, 1, 0)]), boxes3d([small, big]))
    assert shares == pytest.approx(np.array([[0.75, 1.0], [0.0, 0.0]]))


def test_nothing() -> None:
    assert overlap_shares(boxes3d([]), boxes3d([(0, 0, 0, 1, 1, 1, 0)])).shape == (0, 1)
