from typing import get_args

import numpy as np
import pytest
from meshes import open_edges

from lidcam.bags.simulator.world.mesh import Mesh
from lidcam.bags.simulator.world.places.crossing import MAST_TOP_M
from lidcam.bags.simulator.world.places.places import World, ground_height, static_mesh
from lidcam.bags.simulator.world.places.sandbox import NORTH_CAMERAS, SOUTH_CAMERAS
from lidcam.bags.simulator.world.rays import Rays
from lidcam.bags.simulator.world.scene import Scene

WORLDS: tuple[World, ...] = get_args(World)


def without_ground(mesh: Mesh) -> Mesh:
    flat = ("table top", "room floor", "crossing ground", "street ground")
    kept = np.array([material.name not in flat for material in mesh.palette])[mesh.materials]
    return Mesh(mesh.vertices, mesh.triangles[kept], mesh.materials[kept], mesh.palette)


def rays_from(
    origin: tuple[float, float, float], directions: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> Rays:
    n = len(directions)
    return Rays(np.tile(np.array(origin), (n, 1)), directions, np.zeros(n, np.int64))


@pytest.mark.parametrize("world", WORLDS)
def test_worlds_are_built_of_closed_bodies_on_a_ground(world: World) -> None:
    mesh = static_mesh(world)
    assert open_edges(without_ground(mesh)) == 0
    assert 1_000 < len(mesh) < 75_000
    assert np.isfinite(mesh.vertices).all()
    static_mesh.cache_clear()
    np.testing.assert_array_equal(static_mesh(world).vertices, mesh.vertices)


@pytest.mark.parametrize(("origin", "heading_deg"), [*NORTH_CAMERAS, *SOUTH_CAMERAS])
def test_cameras_of_the_sandbox_look_past_their_mast(origin: tuple[float, float, float], heading_deg: float) -> None:
    turn = np.deg2rad(heading_deg + np.linspace(-32, 32, 65))
    tilt = np.deg2rad(-18)
    down = np.stack([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.full(65, np.sin(tilt))], 1)
    distance = Scene(static_mesh("sandbox"), []).cast(rays_from(origin, down)).distance_m
    assert (distance > 0.5).mean() > 0.85


@pytest.mark.parametrize("z", [MAST_TOP_M + 0.1, 6.5])
def test_sensors_stand_free_above_the_masts_of_the_crossing(z: float) -> None:
    scene = Scene(static_mesh("crossing"), [])
    turn = np.linspace(-np.pi, np.pi, 181)[:-1]
    down = np.deg2rad(-15)
    directions = np.stack([np.cos(turn) * np.cos(down), np.sin(turn) * np.cos(down), np.full(180, np.sin(down))], 1)
    for x in (-9.5, 9.5):
        for y in (-9.5, 9.5):
            assert scene.cast(rays_from((x, y, z), directions)).distance_m.min() > 1.0


@pytest.mark.parametrize("world", ["crossing", "street"])
def test_the_height_of_the_ground_is_that_of_the_mesh(world: World) -> None:
    scene = Scene(static_mesh(world), [])
    generator = np.random.default_rng(3)
    places = generator.uniform(-14, 14, (4000, 2)) + ([0, 0] if world == "crossing" else [60, 0])
    origins = np.c_[places, np.full(4000, 0.3)]
    hits = scene.cast(Rays(origins, np.tile([0.0, 0.0, -1.0], (4000, 1)), np.zeros(4000, np.int64)))
    found = 0.3 - hits.distance_m
    flat = hits.normal[:, 2] > 0.99
    wrong = np.abs(found - ground_height(world, places)) > 0.01
    assert (wrong & flat & (found < 0.15)).mean() < 0.02  # feet of poles, benches, the polygon of the round kerb
    assert (found[flat] > 0.1).any()
