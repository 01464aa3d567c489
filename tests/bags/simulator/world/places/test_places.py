from typing import get_args

import numpy as np
import pytest
from meshes import open_edges

from lidcam.bags.simulator.world.mesh import Mesh
from lidcam.bags.simulator.world.places.places import HEIGHTS, World, static_mesh
from lidcam.bags.simulator.world.scene import Rays, Scene

WORLDS: tuple[World, ...] = get_args(World)


def without_ground(mesh: Mesh) -> Mesh:
    flat = ("table top", "room floor", "crossing ground", "street ground")
    kept = np.array([material.name not in flat for material in mesh.palette])[mesh.materials]
    return Mesh(mesh.vertices, mesh.triangles[kept], mesh.materials[kept], mesh.palette)


@pytest.mark.parametrize("world", WORLDS)
def test_worlds_are_built_of_closed_bodies_on_a_ground(world: World) -> None:
    mesh = static_mesh(world)
    assert open_edges(without_ground(mesh)) == 0
    assert 1_000 < len(mesh) < 75_000
    assert np.isfinite(mesh.vertices).all()
    static_mesh.cache_clear()
    np.testing.assert_array_equal(static_mesh(world).vertices, mesh.vertices)


@pytest.mark.parametrize("world", ["crossing", "street"])
def test_the_height_of_the_ground_is_that_of_the_mesh(world: World) -> None:
    scene = Scene(static_mesh(world), [])
    generator = np.random.default_rng(3)
    places = generator.uniform(-14, 14, (4000, 2)) + ([0, 0] if world == "crossing" else [60, 0])
    origins = np.c_[places, np.full(4000, 0.3)]
    hits = scene.cast(Rays(origins, np.tile([0.0, 0.0, -1.0], (4000, 1)), np.zeros(4000, np.int64)))
    found = 0.3 - hits.distance_m
    flat = hits.normal[:, 2] > 0.99
    wrong = np.abs(found - HEIGHTS[world](places)) > 0.01
    assert (wrong & flat & (found < 0.15)).mean() < 0.02  # feet of poles, benches, the polygon of the round kerb
    assert (found[flat] > 0.1).any()
