import json
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import oracle_cloud, shared
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.clouds import Plane, Relief
from lidcam.pipeline.core.settings.combine import GroundConfig
from lidcam.pipeline.filters.ground import find_ground
from lidcam.pipeline.native import kernels

ORIGIN = np.zeros((1, 3))
FINITE_SCENES = ("odd_cloud2_small", "odd_dups", "odd_tiny", "s10k_0", "s10k_1", "s30k_0")
KITTI_SEQUENCE = tuple(f"kitti_raw_sequence/velodyne_points/{frame:010d}.bin" for frame in range(15))
KITTI_OBJECT = tuple(f"kitti_object/training/velodyne/{frame:06d}.bin" for frame in range(4))


def tilt_deg(a: npt.ArrayLike, b: npt.ArrayLike) -> float:
    """Angle between two normals."""
    return float(np.degrees(np.arccos(np.clip(np.dot(a, b) / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


def floor(rng: np.random.Generator, count: int, *, z: float = -1.7, half_m: float = 20.0, noise_m: float = 0.02) -> F64:
    return np.column_stack([rng.uniform(-half_m, half_m, (count, 2)), rng.normal(z, noise_m, count)])


def wall(rng: np.random.Generator, count: int, *, x: float = 8.0, z: tuple[float, float] = (-1.7, 3.0)) -> F64:
    return np.column_stack([rng.normal(x, 0.02, count), rng.uniform(-20, 20, count), rng.uniform(*z, count)])


def height_m(plane: Plane | None) -> float:
    """At the origin."""
    assert plane is not None
    return float(plane.height_m(np.zeros(2)))


def ground_of(points: F64, **options: Any) -> Plane | None:
    height = options.pop("ground_height_m", None)
    origins = options.pop("origins", ORIGIN)
    return find_ground(points.astype(np.float32), origins, config=GroundConfig(**options), ground_height_m=height)


def kitti(path: str) -> F32:
    return np.fromfile(shared(f"data/{path}"), "<f4").reshape(-1, 4)[:, :3].copy()


# --- against PCL, Open3D and real streets


def oracle_kept(scene: str) -> tuple[F32, F64, dict[str, Any]]:
    """What PCL's outlier removal kept, the lidars' origins, and PCL's plane of it."""
    folder, (cloud, offsets) = shared(f"oracles/combiner/{scene}"), oracle_cloud(scene)
    kept = cloud[np.fromfile(folder / "sor_kept.bin", "<i4")]
    return kept[np.isfinite(kept).all(axis=1)], offsets, json.loads((folder / "plane.json").read_text())


@pytest.mark.parametrize("scene", [*FINITE_SCENES, "odd_nan"])
def test_the_plane_is_pcls(scene: str) -> None:
    cloud, origins, pcl = oracle_kept(scene)
    plane = find_ground(cloud, origins, config=GroundConfig())
    assert plane is not None
    assert tilt_deg(plane.normal, pcl["coefficients"][:3]) < 0.05
    assert plane.offset_m == pytest.approx(pcl["coefficients"][3], abs=0.01)


def test_a_street_is_found_and_stays_still_from_frame_to_frame() -> None:
    planes = [find_ground(kitti(path), ORIGIN, config=GroundConfig()) for path in KITTI_SEQUENCE]
    heights = [height_m(plane) for plane in planes]
    assert all(abs(height + 1.73) < 0.05 for height in heights)  # the velodyne's height on KITTI's car
    assert np.abs(np.diff(heights)).max() < 0.01
    normals = [plane.normal for plane in planes if plane]
    assert max(tilt_deg(normal, [0, 0, 1]) for normal in normals) < 1.5
    assert max(tilt_deg(a, b) for a, b in zip(normals[1:], normals, strict=False)) < 0.2


@pytest.mark.parametrize("path", [*KITTI_OBJECT, "kitti_object_8/000008.bin"])
def test_other_streets(path: str) -> None:
    plane = find_ground(kitti(path), ORIGIN, config=GroundConfig(), ground_height_m=-1.73)
    assert plane is not None
    assert height_m(plane) == pytest.approx(-1.73, abs=0.08)
    assert tilt_deg(plane.normal, [0, 0, 1]) < 3


# --- what may be ground


def test_a_floor_among_walls_with_more_points() -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate([wall(rng, 60_000), wall(rng, 60_000, x=-7.0), floor(rng, 6_000)])
    plane = ground_of(points)
    assert plane is not None
    assert tilt_deg(plane.normal, [0, 0, 1]) < 0.3
    assert height_m(plane) == pytest.approx(-1.7, abs=0.02)


def test_car_roofs_do_not_lift_the_ground() -> None:
    rng = np.random.default_rng(1)
    roofs = np.column_stack([rng.uniform(3, 9, (8_000, 2)), rng.normal(-0.2, 0.02, 8_000)])
    assert height_m(ground_of(np.concatenate([floor(rng, 10_000), roofs]))) == pytest.approx(-1.7, abs=0.01)


def test_the_rigs_height_decides_between_two_floors() -> None:
    rng = np.random.default_rng(2)
    points = np.concatenate([floor(rng, 20_000, z=-5.0), floor(rng, 8_000, z=-1.7, half_m=10)])
    assert height_m(ground_of(points, ground_height_m=-1.6)) == pytest.approx(-1.7, abs=0.01)
    assert ground_of(points, ground_height_m=-3.0) is None


def test_the_ground_is_below_every_lidar() -> None:
    rng = np.random.default_rng(3)
    points = np.concatenate([floor(rng, 20_000, z=2.0), floor(rng, 5_000, z=-1.7)])  # a ceiling has more points
    assert height_m(ground_of(points)) == pytest.approx(-1.7, abs=0.01)
    below = np.array([[0, 0, 0.0], [5, 5, -2.0]])
    assert ground_of(points, origins=below) is None


def test_what_level_beams_meet_in_a_room_is_no_floor() -> None:
    rng = np.random.default_rng(10)
    walls = np.concatenate([wall(rng, 9_000, x=x, z=(-0.5, 1.5)) for x in (-4.0, 4.0)])
    level = floor(rng, 6_000, z=-0.02, half_m=6.0)  # the ring that points along the floor meets whatever stands there
    assert ground_of(np.concatenate([walls, level])) is None
    assert height_m(ground_of(np.concatenate([walls, level, floor(rng, 3_000, z=-0.9)]))) == pytest.approx(
        -0.9, abs=0.01
    )


def test_a_real_room_without_a_floor_in_view() -> None:
    data = shared("data/velodyne_packets/vlp16/1673400472138016708.pcd").read_bytes()
    points = np.frombuffer(data.split(b"DATA binary\n", 1)[1], [("xyz", "<f4", 3), ("rest", "V20")])["xyz"]
    assert len(points) == 14_831
    assert ground_of(points.astype(np.float64)) is None


@pytest.mark.parametrize("z", [-0.05, 0.0, 0.1])
def test_the_ground_of_clouds_given_in_a_frame_on_it(z: float) -> None:
    """As `base_link` is, in which some drivers publish: the lidar itself stands higher."""
    rng = np.random.default_rng(11)
    street = np.concatenate([floor(rng, 9_000, z=z), wall(rng, 3_000, x=7.0, z=(z, 4.0))])
    assert height_m(ground_of(street)) == pytest.approx(z, abs=0.01)
    below = rng.uniform((-6, -6, z - 1.5), (6, 6, z - 0.3), (200, 3))
    assert ground_of(np.concatenate([street, below])) is None


@pytest.mark.parametrize(("slope_deg", "found"), [(0, True), (8, True), (15, False)])
def test_slope(slope_deg: float, found: bool) -> None:
    points = floor(np.random.default_rng(4), 10_000)
    points[:, 2] += np.tan(np.radians(slope_deg)) * points[:, 0]
    points = points[points[:, 2] < -0.3]
    plane = ground_of(points)
    assert (plane is not None) is found
    if plane is not None:
        assert tilt_deg(plane.normal, [-np.tan(np.radians(slope_deg)), 0, 1]) < 0.3


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.array([[1.0, 2.0, -1.0]]),
        np.array([[1.0, 2.0, -1.0], [4.0, 2.0, -1.0]]),
        np.repeat([[1.0, 2.0, -1.0]], 50, axis=0),
        np.column_stack([np.arange(50.0), np.zeros(50), np.full(50, -1.0)]),
        wall(np.random.default_rng(5), 20_000),
        wall(np.random.default_rng(6), 5_000, z=(-1.7, -1.5)),
        np.concatenate([wall(np.random.default_rng(7), 9_000, x=x) for x in (-9.0, 8.0)]),
        np.random.default_rng(8).uniform(-20, 20, (20_000, 3)),
    ],
    ids=["empty", "one", "two", "same", "line", "wall", "kerb", "street canyon without street", "fog"],
)
def test_no_ground(points: F64) -> None:
    assert ground_of(points) is None


# --- properties


def test_the_same_input_gives_the_same_bits_and_the_seed_only_the_last_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = kitti(KITTI_SEQUENCE[0])
    first, again = (find_ground(cloud, ORIGIN, config=GroundConfig()) for _ in range(2))
    monkeypatch.setattr("lidcam.pipeline.filters.ground.SEED", 1)
    other = find_ground(cloud, ORIGIN, config=GroundConfig())
    assert first is not None
    assert again is not None
    assert other is not None
    assert first.normal.tobytes() == again.normal.tobytes()
    assert first.offset_m == again.offset_m
    assert tilt_deg(first.normal, other.normal) < 0.05


PLANE = np.array([0.05, -0.1, 0.9937303, 1.2], np.float32)


def points(count: int) -> F32:
    rng = np.random.default_rng(count)
    xyz = rng.uniform(-20, 20, (3, count))
    xyz[2] = -(PLANE[0] * xyz[0] + PLANE[1] * xyz[1] + PLANE[3]) / PLANE[2] + rng.normal(0, 0.1, count)
    return xyz.astype(np.float32)


def heights_of(xyz: F32, plane: F32) -> F32:
    heights: F32 = xyz[0] * plane[0] + xyz[1] * plane[1] + xyz[2] * plane[2] + plane[3]
    return heights


@pytest.mark.parametrize("count", [0, 1, 3, 5000])
def test_counts(count: int) -> None:
    xyz, rng = points(count), np.random.default_rng(1)
    planes = (PLANE + rng.normal(0, 0.01, (7, 4))).astype(np.float32)
    for held, beside, plane in zip(*kernels.count_layers(xyz, planes, 0.1), planes, strict=True):
        heights = heights_of(xyz, plane)
        below, within, above = np.diff([(heights <= np.float32(k) * np.float32(0.1)).sum() for k in (-3, -1, 1, 3)])
        assert (held, beside) == (within, max(below, above))


def is_scatter(centre: F64, scatter: F64, near: F32) -> None:
    np.testing.assert_allclose(centre, near.mean(axis=1, dtype=float), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(scatter, np.cov(near, bias=True, dtype=float), rtol=1e-11, atol=1e-12)


def same_near(xyz: F32, layer_m: float) -> None:
    count, centre, scatter = kernels.scatter_near(xyz, PLANE, layer_m)
    heights = np.abs(heights_of(xyz, PLANE))
    within = heights[heights <= np.float32(layer_m)]
    assert count == len(within)
    if count:
        near_m = min(np.float32(layer_m), np.float32(3 * 1.4826 * float(np.median(within)) + 1e-6))
        is_scatter(centre, scatter, xyz[:, heights <= near_m])
    else:
        assert not np.append(centre, scatter).any()


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5000])
@pytest.mark.parametrize("layer_m", [0.05, 1.0, 100.0])
def test_near_the_plane(count: int, layer_m: float) -> None:
    xyz = points(count)
    xyz[2, ::5] += 30  # far from it, but within the layer if that is thick
    same_near(xyz, layer_m)


@given(xyz=st.integers(0, 50).flatmap(lambda n: arrays(np.float32, (3, n), elements=st.floats(-2, 2, width=16))))
def test_near_the_plane_if_many_are_equally_far(xyz: F32) -> None:
    same_near(xyz, 0.7)


# --- which points belong to the ground


@pytest.mark.parametrize("count", [0, 1, 3000])
@pytest.mark.parametrize("distance_m", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("offset_m", [-0.4, 0.0, 0.4])
def test_points_on_the_ground(count: int, distance_m: float, offset_m: float) -> None:
    xyz = np.ascontiguousarray(points(count).T) * np.float32(2)  # beyond the grid, too
    kept = np.random.default_rng(5).random(count) < 0.8
    height = xyz[:, 0] * PLANE[0] + xyz[:, 1] * PLANE[1] + xyz[:, 2] * PLANE[2] + PLANE[3]
    on_plane = np.abs(height) <= np.float32(distance_m)
    relief = Relief(np.array([-20.0, -15.0]), 4.0, np.random.default_rng(4).normal(0, 0.1, (9, 12)) + offset_m)
    left, level, above = kernels.parted(xyz, kept, PLANE, distance_m, relief.origin_xy, relief.cell_m, relief.offsets_m)
    np.testing.assert_array_equal(left, np.flatnonzero(kept & ~on_plane))
    np.testing.assert_array_equal(level, np.flatnonzero(kept & on_plane))
    on_ground = np.abs(height - relief.offset_m(xyz[:, :2])) <= distance_m
    np.testing.assert_array_equal(above, np.flatnonzero(~on_ground))
