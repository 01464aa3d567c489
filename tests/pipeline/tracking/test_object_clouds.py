from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d
from frames import tracks_of

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.detections import Fused, Source
from lidcam.pipeline.tracking.object_clouds import ObjectCloud, points_in_objects, voxel_of

SIZE = np.array([4.0, 2.0, 1.5])


def cloud(xyz: object, seconds: object = 0.0) -> PointCloud:
    table = np.array(xyz, np.float32).reshape(-1, 3)
    offsets_ns = np.broadcast_to(np.array(seconds) * 1e9, len(table)).astype(np.int32)
    zeros = np.zeros(len(table), np.float32)
    return PointCloud(0, "site", table, zeros, zeros.astype(np.uint16), offsets_ns, has_time=True)


def fused(*places: tuple[float, float, float], speed_m_s: float = 0.0, yaw_rate: float = 0.0) -> Fused:
    """Tracked objects at x, y, yaw, each going along its yaw."""
    boxes = boxes3d([[x, y, 0.75, *SIZE, yaw] for x, y, yaw in places])
    velocities = speed_m_s * np.array([[np.cos(yaw), np.sin(yaw)] for *_, yaw in places]).reshape(-1, 2)
    tracks = replace(tracks_of(range(1, len(boxes) + 1), velocities), yaw_rates=np.full(len(boxes), yaw_rate))
    return Fused(boxes, np.zeros(len(boxes), np.int32), np.arange(len(boxes)), tracks=tracks)


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_a_point_is_placed_by_where_the_object_was_at_its_time(yaw: float) -> None:
    """Front left corner and middle of the right side of a car that drives 10 m/s, measured 50 ms apart."""
    own = np.array([[2.0, 1.0, 0.5], [0.0, -1.0, 0.0]])
    forward = own[:, 0] + np.array([0.0, -0.5])  # half a metre ago
    xy = [forward * np.cos(yaw) - own[:, 1] * np.sin(yaw), forward * np.sin(yaw) + own[:, 1] * np.cos(yaw)]
    xyz = np.column_stack([5 + xy[0], 3 + xy[1], own[:, 2] + 0.75])
    ((row, found, points, moves),) = points_in_objects(fused((5, 3, yaw), speed_m_s=10.0), cloud(xyz, [0.0, -0.05]))
    np.testing.assert_allclose(found, own, atol=1e-5)
    assert (row, points.tolist(), moves) == (0, [0, 1], True)


def test_a_turning_object_is_turned_back() -> None:
    ((_, found, _, moves),) = points_in_objects(fused((0, 0, 0), yaw_rate=2.0), cloud([[0, 0.9, 1]], -0.1))
    np.testing.assert_allclose(found, [[-0.9 * np.sin(0.2), 0.9 * np.cos(0.2), 0.25]], atol=1e-6)
    assert not moves


def test_points_beside_below_and_of_a_nearer_object_do_not_count() -> None:
    xyz = [[2.15, 0, 1], [2.3, 0, 1], [0, 0, 0.01], [0, 0, -0.05], [0, 1.08, 1], [0, 1.15, 1]]
    both = fused((0, 0, 0), (0, 2.1, 0))
    assert [points.tolist() for _, _, points, _ in points_in_objects(both, cloud(xyz))] == [[0, 2], [4, 5]]


def test_what_is_not_tracked_or_not_seen_has_no_points() -> None:
    seen = fused((0, 0, 0), (5, 0, 0), (10, 0, 0), (15, 0, 0))
    assert seen.tracks is not None
    kinds = [Source.LIDAR, Source.PREDICTED, Source.CAMERA, Source.BOTH]
    objects = replace(seen.objects, sources=np.array(kinds, np.uint8))
    seen = replace(seen, objects=objects, tracks=replace(seen.tracks, ids=np.array([0, 2, 3, 4], np.int64)))
    points = cloud([[x, 0, 1] for x in (0, 5, 10, 15)])
    assert [(row, rows.tolist()) for row, _, rows, _ in points_in_objects(seen, points)] == [(3, [3])]
    assert [*points_in_objects(replace(seen, tracks=None), points)] == []
    assert [rows.tolist() for *_, rows, _ in points_in_objects(seen, cloud([]))] == [[]]


def body(seed: int, count: int = 3000) -> np.ndarray:
    """Points of a car's surface (N, 5): a lower box and a cabin on it, so that every direction is fixed."""
    random = np.random.default_rng(seed)
    lower, cabin = np.array([2.0, 1.0, 0.35]), np.array([1.0, 0.85, 0.3])
    faces = random.uniform(-1, 1, (count, 3))
    axis, is_cabin = random.integers(0, 3, count), np.arange(count) % 3 == 0
    faces[np.arange(count), axis] = np.sign(faces[np.arange(count), axis])
    xyz = np.where(is_cabin[:, None], faces * cabin + [-0.3, 0, 0.4], faces * lower + [0, 0, -0.3])
    return np.column_stack([xyz, np.full((count, 2), seed)])


@pytest.mark.parametrize(
    ("shift_m", "moves", "left_m"),
    [(0.08, True, 0.015), (0.08, False, 0.08), (0.15, True, 0.15)],
    ids=["near", "standing", "far"],
)
def test_a_frame_is_registered_where_the_object_moves_and_the_track_is_about_right(
    shift_m: float, moves: bool, left_m: float
) -> None:
    gathered = ObjectCloud(0, 0.04)
    gathered.add(body(0), SIZE, moves=True, max_points=10**6)
    count, new = len(gathered.points), body(1)
    new[:, :2] += [shift_m, -shift_m / 2]
    gathered.add(new, SIZE, moves=moves, max_points=10**6)
    added = gathered.points[gathered.points[:, 3] == 1, :3]
    assert len(gathered.points) == count + len(added) > count
    sides = added[(np.abs(added[:, 2] + 0.3) < 0.2) & (added[:, 0] > 1.9), 0]
    assert np.median(sides) - 2.0 == pytest.approx(left_m, abs=0.015)


def test_voxels_grow_where_there_are_too_many_points() -> None:
    gathered = ObjectCloud(0, voxel_of(SIZE))
    assert gathered.voxel_m == pytest.approx(0.04)
    for seed in range(3):
        gathered.add(body(seed), SIZE, moves=False, max_points=800)
        assert len(gathered.points) <= 800
    assert gathered.voxel_m > 0.1
    cells = np.floor(gathered.points[:, :3].astype(np.float64) / gathered.voxel_m)
    assert len(np.unique(cells, axis=0)) == len(cells) > 400
