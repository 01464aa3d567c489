import numpy as np
from detections import boxes2d, boxes3d
from pipeline.fusion.begun.beginning import Begun
from pipeline.fusion.begun.frustums import FrustumPoints
from pipeline.fusion.begun.parting import choose_parts, find_hosts, find_merged, share_points
from seen_boxes import camera_at, views_of

from pipeline.core.arrays import F64
from pipeline.detectors.protocols import Candidates3D
from pipeline.fusion.cameras.sightings import see


def begun(*counts: int) -> Begun:
    """Objects of consecutive points."""
    starts = np.cumsum([0, *counts])
    n, rows = len(counts), np.arange(starts[-1])
    return Begun(np.arange(n), Candidates3D.empty(), np.ones(n), np.zeros(n), rows, starts[:-1].astype(np.int64))


def around(x: float, y: float, count: int) -> F64:
    return np.array([x, y, 1.0]) + np.random.default_rng(count).uniform(-0.2, 0.2, (count, 3))


def test_host_holds_most_of_the_points() -> None:
    boxes = boxes3d([(0, 0, 1, 4, 2, 2, 0), (10, 0, 1, 2, 4, 2, np.pi / 2), (10, 5, 1, 1, 1, 2, 0)])
    parts = [around(1, 0.5, 9), around(11.5, 0, 5), np.concatenate([around(10, 5, 4), around(13, 5, 6)])]
    xyz = np.concatenate(parts).astype(np.float32)
    assert find_hosts(xyz, begun(9, 5, 10), boxes).tolist() == [0, 1, -1]


def test_no_host_and_no_object() -> None:
    assert find_hosts(np.ones((3, 3), np.float32), begun(3), boxes3d([])).tolist() == [-1]
    assert len(find_hosts(np.ones((3, 3), np.float32), begun(), boxes3d([(0, 0, 0, 1, 1, 1, 0)]))) == 0


def test_host_is_merged_if_the_same_camera_sees_another_object_in_it() -> None:
    views = views_of(camera_at("a", (0.0, 0.0, 2.0)), camera_at("b", (0.0, 0.0, 2.0)))
    boxes = boxes2d([(10, 10, 20, 20, 0.9, 0), (30, 10, 40, 20, 0.8, 0)])
    sightings = see(views, {"a": boxes, "b": boxes})
    partner = np.array([-1, 5, 7, -1])
    # Of camera a: in the host of its other box, in that of camera b's, in none; of camera b: in the host of its own.
    found = find_merged(sightings, partner, np.array([0, 0, 0, 3]), np.array([5, 7, -1, 7]))
    assert found.tolist() == [1, -1, -1, 2]


def test_points_go_to_the_frustum_whose_middle_is_nearest() -> None:
    rows, group = np.array([4, 5, 6, 5, 6, 7, 5]), np.array([0, 0, 0, 1, 1, 1, 2])
    x = np.array([0.1, 0.5, 0.9, 0.1, 0.4, 0.9, 0.7])
    found, team = FrustumPoints(rows, group, x, x, x), np.array([0, 0, 9])
    shared = found.select(share_points(found, team))
    assert list(zip(shared.rows, shared.group, strict=True)) == [(4, 0), (5, 0), (6, 1), (7, 1), (5, 2)]
    assert len(share_points(found.select(np.zeros(0, np.int64)), team)) == 0


def parts(
    iou: list[float], row: list[int], team: list[int], *, host_ground_m2: float = 1.0
) -> tuple[list[int], list[int]]:
    """Parts of cluster 0 by 2D boxes 0 to 2 of one camera and 3 to 5 of another; 0 and 3 are matched with it."""
    partner = np.array([0, -1, -1, 0, -1, -1])
    owner, other = choose_parts(
        np.array(iou),
        np.array(row, np.int64),
        np.array(team, np.int64),
        np.full(len(iou), 0.36),
        partner,
        np.where(partner == 0, 0.5, 0.0),
        np.array([host_ground_m2]),
    )
    return owner.tolist(), other.tolist()


def test_cluster_with_room_for_two_is_parted() -> None:
    assert parts([0.7, 0.6], [0, 1], [0, 0]) == ([0], [1])


def test_cluster_is_left_whole_where_its_own_part_is_worse_or_missing() -> None:
    assert parts([0.3, 0.6], [0, 1], [0, 0]) == ([], [])
    assert parts([0.6], [1], [0]) == ([], [])
    assert parts([0.6], [0], [0]) == ([], [])
    assert parts([], [], []) == ([], [])


def test_cluster_without_room_for_two_is_left_whole() -> None:
    assert parts([0.7, 0.6], [0, 1], [0, 0], host_ground_m2=0.5) == ([], [])


def test_camera_that_sees_most_parts_a_cluster() -> None:
    assert parts([0.7, 0.6, 0.8, 0.6, 0.6], [0, 1, 3, 4, 5], [0, 0, 3, 3, 3]) == ([2], [3, 4])
    assert parts([0.7, 0.6, 0.8, 0.6], [0, 1, 3, 4], [0, 0, 3, 3]) == ([0], [1])
