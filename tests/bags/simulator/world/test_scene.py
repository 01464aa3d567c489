import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worlds import BLACK, GREY, WHITE, EvenPath, box_mover, random_rays, scene, wall

from lidcam.bags.simulator.world.mesh import box
from lidcam.bags.simulator.world.motion import MountedPath, turned
from lidcam.bags.simulator.world.rays import STATIC, Hits, Rays
from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.transform import Transform

TURNING = EvenPath((0.5, -1.0, -0.4), (30.0, 8.0, 0.0), 0.3, 3.0)


def slab(origins: F64, directions: F64, center: F64, size: F64) -> F64:
    """Distance from outside to a box along its own axes (Kay and Kajiya 1986); infinite for a miss."""
    with np.errstate(divide="ignore"):
        ends = np.sort(np.stack([(center + side * size / 2 - origins) / directions for side in (-1, 1)]), axis=0)
    near, far = ends[0].max(1), ends[1].min(1)
    return np.asarray(np.where((near <= far) & (near > 0), near, np.inf))


def rays_of(*origin_and_direction: tuple[float, ...], times_ns: tuple[int, ...] | None = None) -> Rays:
    rows = np.array(origin_and_direction, np.float64).reshape(-1, 6)
    times = np.zeros(len(rows), np.int64) if times_ns is None else np.array(times_ns, np.int64)
    return Rays(rows[:, :3], rows[:, 3:], times)


def one_by_one(world: Scene, rays: Rays) -> list[Hits]:
    return [world.cast(rays.select(np.array([row]))) for row in range(len(rays))]


@settings(max_examples=10, derandomize=True)
@given(st.integers(0, 1000))
def test_a_box_that_moves_and_turns_is_where_it_is_at_the_time_of_each_ray(seed: int) -> None:
    size = (4.0, 2.0, 1.5)
    rays = random_rays(800, seed=seed)
    hits = scene([], [box_mover("car", TURNING, size)]).cast(rays)
    to_box = TURNING.poses(rays.times_ns).inverse()
    origins, directions = to_box.apply(rays.origins), turned(to_box.rotation, rays.directions)
    outside = (np.abs(origins - (0, 0, 0.75)) > np.array(size) / 2 + 1e-3).any(1)
    expected = slab(origins, directions, np.array([0, 0, 0.75]), np.array(size))
    # Between two moments the way is taken for straight: 0.1 mm on the body, more along rays that graze it.
    np.testing.assert_allclose(hits.distance_m[outside], expected[outside], rtol=1e-5, atol=2e-3)
    hit = np.isfinite(hits.distance_m) & outside
    assert hit.sum() > 40
    np.testing.assert_allclose(hits.local[hit], (origins + directions * expected[:, None])[hit], atol=2e-3)
    assert (np.abs(np.abs(hits.local[hit] - (0, 0, 0.75)) - np.array(size) / 2).min(1) < 1e-5).all()
    at_its_time = to_box.apply(rays.origins + rays.directions * np.where(hit, hits.distance_m, 0)[:, None])
    np.testing.assert_allclose(at_its_time[hit], hits.local[hit], atol=1e-4)


def test_rays_together_meet_what_each_meets_alone() -> None:
    wheel = box((0, 0, 0), (0.5, 0.5, 0.5), BLACK)
    mounted = MountedPath(TURNING, Transform.from_quaternion("car", "wheel", np.array([1.2, 0.8, 0.3]), np.eye(4)[3]))
    movers = [
        box_mover("car", TURNING, (4, 2, 1.5), parts=[(box((0, 0, 0.7), (2, 1, 1), GREY), TURNING), (wheel, mounted)]),
        box_mover("far", EvenPath((0, 300, 0))),
        box_mover("slow", EvenPath((-2, 0, 0), (0, -3, 0)), (1, 1, 1), WHITE),
    ]
    world = scene([box((0, 0, -3), (20, 20, 1), WHITE)], movers)
    rays = random_rays(500)
    together, alone = world.cast(rays), one_by_one(world, rays)
    for name in Hits.__slots__:
        values = np.concatenate([getattr(hits, name) for hits in alone])
        np.testing.assert_allclose(getattr(together, name), values, rtol=0, atol=1e-4, err_msg=name)
    assert set(together.mover.tolist()) == {STATIC, 0, 2}
    assert {world.palette[row].name for row in together.material if row >= 0} == {"white", "grey", "black"}


def test_what_images_see_of_what_stands_still_is_what_rays_meet() -> None:
    world = scene([box((4, 2, 1), (9, 0, 0.5), BLACK), wall(20.0, WHITE, half_m=6)], [])
    directions = np.random.default_rng(3).uniform([0.5, -1, -0.6], [1, 1, 0.6], (5000, 3))
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    origin = np.array([0.5, -0.25, 1.0])
    rays = Rays(np.tile(origin, (5000, 1)), directions.astype(np.float64), np.zeros(5000, np.int64))
    hits, seen = world.cast(rays), world.static.surfaces(origin, directions)
    assert 0.1 < np.isfinite(seen.distance).mean() < 0.9
    np.testing.assert_allclose(seen.distance, hits.distance_m, rtol=1e-6)
    np.testing.assert_array_equal(seen.material, hits.material)
    np.testing.assert_allclose(seen.normal, hits.normal, atol=1e-6)
    met = np.isfinite(seen.distance)
    np.testing.assert_allclose(seen.local[met], hits.local[met], atol=1e-5)
    np.testing.assert_array_equal(world.static.distance(origin, directions), seen.distance)
    empty = scene().static.surfaces(origin, directions)
    assert np.isinf(empty.distance).all()
    assert (empty.material == -1).all()


@pytest.mark.parametrize("movers", [[], [box_mover("car", EvenPath((5, 0, 0)))]])
def test_empty_worlds_and_no_rays(movers: list[object]) -> None:
    world = scene([], movers)  # type: ignore[arg-type]  # drawn above
    nothing = world.cast(rays_of())
    assert len(nothing) == 0
    missed = world.cast(rays_of((0, 0, 0.5, 0, 0, 1)))
    assert (missed.distance_m.tolist(), missed.material.tolist(), missed.mover.tolist()) == ([np.inf], [-1], [STATIC])
