import numpy as np
import pytest
from detections import boxes2d, boxes3d
from seen_boxes import camera_at, views_of

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.detections import Matches
from lidcam.pipeline.fusion.cameras.sightings import see
from lidcam.pipeline.fusion.proposals.frustums import FrustumPoints
from lidcam.pipeline.fusion.proposals.parting import (
    choose_parts,
    find_duplicates,
    find_enclosing,
    find_merged,
    find_partners,
    share_points,
)


def points_of(*counts: int) -> tuple[I64, I64]:
    """Rows of the points of objects, which follow each other, and the first of each object."""
    starts = np.cumsum([0, *counts])
    return np.arange(starts[-1]), starts[:-1]


def around(x: float, y: float, count: int) -> F64:
    return np.array([x, y, 1.0]) + np.random.default_rng(count).uniform(-0.2, 0.2, (count, 3))


def test_a_box_encloses_most_of_the_points() -> None:
    boxes = boxes3d([(0, 0, 1, 4, 2, 2, 0), (10, 0, 1, 2, 4, 2, np.pi / 2), (10, 5, 1, 1, 1, 2, 0)])
    parts = [around(1, 0.5, 9), around(11.5, 0, 5), np.concatenate([around(10, 5, 4), around(13, 5, 6)])]
    xyz = np.concatenate(parts).astype(np.float32)
    assert find_enclosing(xyz, *points_of(9, 5, 10), boxes).tolist() == [0, 1, -1]


def test_no_box_and_no_object() -> None:
    assert find_enclosing(np.ones((3, 3), np.float32), *points_of(3), boxes3d([])).tolist() == [-1]
    assert len(find_enclosing(np.ones((3, 3), np.float32), *points_of(), boxes3d([(0, 0, 0, 1, 1, 1, 0)]))) == 0


def test_cluster_is_merged_if_the_same_camera_sees_another_object_in_it() -> None:
    views = views_of(camera_at("a", (0.0, 0.0, 2.0)), camera_at("b", (0.0, 0.0, 2.0)))
    boxes = boxes2d([(10, 10, 20, 20, 0.9, 0), (30, 10, 40, 20, 0.8, 0)])
    sightings = see(views, {"a": boxes, "b": boxes})
    partner = np.array([-1, 5, 7, -1])
    # Of camera a: in the cluster of its other box, in that of camera b's, in none; of camera b: in that of its own.
    found = find_merged(sightings, partner, np.array([0, 0, 0, 3]), np.array([5, 7, -1, 7]))
    assert found.tolist() == [1, -1, -1, 2]


def test_points_go_to_the_frustum_whose_middle_is_nearest() -> None:
    rows, group = np.array([4, 5, 6, 5, 6, 7, 5]), np.array([0, 0, 0, 1, 1, 1, 2])
    x = np.array([0.1, 0.5, 0.9, 0.1, 0.4, 0.9, 0.7])
    found, owner = FrustumPoints(rows, group, x, x, x), np.array([0, 0, 9])
    shared = found.select(share_points(found, owner))
    assert list(zip(shared.rows, shared.group, strict=True)) == [(4, 0), (5, 0), (6, 1), (7, 1), (5, 2)]
    assert len(share_points(found.select(np.zeros(0, np.int64)), owner)) == 0


@pytest.mark.parametrize(
    ("iou", "row", "owner", "ground_m2", "expected"),
    [
        pytest.param([0.7, 0.6], [0, 1], [0, 0], 1.0, ([0], [1]), id="room for two"),
        pytest.param([0.7, 0.6], [0, 1], [0, 0], 0.5, ([], []), id="no room for two"),
        pytest.param([0.3, 0.6], [0, 1], [0, 0], 1.0, ([], []), id="its own part is worse"),
        pytest.param([0.6], [1], [0], 1.0, ([], []), id="its own part is missing"),
        pytest.param([0.6], [0], [0], 1.0, ([], []), id="no other part"),
        pytest.param([], [], [], 1.0, ([], []), id="nothing"),
        pytest.param(
            [0.7, 0.6, 0.8, 0.6, 0.6], [0, 1, 3, 4, 5], [0, 0, 3, 3, 3], 1.0, ([2], [3, 4]), id="which sees most"
        ),
        pytest.param([0.7, 0.6, 0.8, 0.6], [0, 1, 3, 4], [0, 0, 3, 3], 1.0, ([0], [1]), id="both see as much"),
    ],
)
def test_which_camera_parts_a_cluster(
    iou: list[float], row: list[int], owner: list[int], ground_m2: float, expected: tuple[list[int], list[int]]
) -> None:
    """Parts of cluster 0 by 2D boxes 0 to 2 of one camera and 3 to 5 of another; 0 and 3 are matched with it."""
    partner = np.array([0, -1, -1, 0, -1, -1])
    rows, owners = np.array(row, np.int64), np.array(owner, np.int64)
    taken = np.full(len(iou), 0.36), partner, np.where(partner == 0, 0.5, 0.0), np.array([ground_m2])
    kept, other = choose_parts(np.array(iou), rows, owners, *taken)
    assert (kept.tolist(), other.tolist()) == expected


VIEWS = views_of(camera_at("a", (0.0, 0.0, 2.0)), camera_at("b", (0.0, 0.0, 2.0)))
LOW, HIGH = (100.0, 100, 200, 200, 0.3, 0), (300.0, 100, 400, 200, 0.9, 0)


def matched(*pairs: tuple[int, int, float]) -> Matches:
    table = np.array(pairs, np.float64).reshape(-1, 3)
    nothing = np.full((9, 4), np.nan, np.float32)
    return Matches(
        table[:, :2].astype(np.int64),
        table[:, 2].astype(np.float32),
        nothing,
        np.zeros(9, np.float32),
        np.zeros((9, 4), np.float32),
    )


def test_rows_are_those_of_the_2d_boxes_however_they_are_ordered() -> None:
    sightings = see(VIEWS, {"a": boxes2d([LOW, HIGH]), "b": boxes2d([HIGH])})
    partner, iou = find_partners(sightings, {"a": matched((7, 0, 0.5)), "b": matched((2, 0, 0.75))}, ("a", "b"))
    assert sightings.rows.tolist() == [1, 0, 0]
    assert partner.tolist() == [-1, 7, 2]
    assert iou.tolist() == [0.0, 0.5, 0.75]


def test_camera_without_boxes_or_matches() -> None:
    sightings = see(VIEWS, {"b": boxes2d([LOW])})
    partner, iou = find_partners(sightings, {"a": matched(), "b": matched()}, ("a", "b"))
    assert partner.tolist() == [-1]
    assert iou.tolist() == [0.0]


def test_second_box_around_a_matched_object_is_a_duplicate() -> None:
    near, beside = (102.0, 102, 203, 203, 0.8, 3), (150.0, 100, 250, 200, 0.7, 0)
    boxes = boxes2d([LOW, near, beside])
    sightings = see(VIEWS, {"a": boxes, "b": boxes})
    partner, _ = find_partners(sightings, {"a": matched((0, 0, 0.9)), "b": matched()}, ("a", "b"))
    duplicates = find_duplicates(sightings, partner)
    assert [(int(sightings.cameras[k]), int(sightings.rows[k])) for k in np.flatnonzero(duplicates)] == [(0, 1)]
