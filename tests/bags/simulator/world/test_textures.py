from functools import cache
from typing import get_args

import numpy as np
import pytest

from lidcam.bags.simulator.world.mesh import Material, Texture
from lidcam.bags.simulator.world.places.places import World, static_mesh
from lidcam.bags.simulator.world.textures import TEXTURES, linear, surface_reflectivity, surface_rgb
from lidcam.pipeline.core.arrays import F32

UP = np.array([[0.0, 0.0, 1.0]])


@cache
def ground_of(world: World) -> Material:
    return next(material for material in static_mesh(world).palette if material.texture == world)


def ground(world: World, places: list[tuple[float, float]]) -> tuple[F32, F32]:
    """Mean brightness over a few centimetres about each place, and reflectivity."""
    spread = 0.002 if world == "sandbox" else 0.02
    offsets = np.array([(a, b) for a in (-spread, 0, spread) for b in (-spread, 0, spread)])
    xy = (np.array(places)[:, None] + offsets).reshape(-1, 2)
    local = np.c_[xy, np.zeros(len(xy))]
    rows, normal = np.zeros(len(xy), np.int64), np.tile(UP, (len(xy), 1))
    rgb = surface_rgb([ground_of(world)], rows, local, normal)
    reflectivity = surface_reflectivity([ground_of(world)], rows, local, normal)
    return rgb.reshape(len(places), 9, 3).mean(1), np.median(reflectivity.reshape(len(places), 9), axis=1)


@pytest.mark.parametrize(
    ("world", "white", "dark", "green"),
    [
        (
            "crossing",
            [(30.0, 6.76), (20.0, 3.5), (12.2, 3.0), (10.0, 0.0), (-12.2, -3.0), (-3.0, 12.2), (3.0, -12.2)],
            [(0.0, 0.0), (30.0, 1.75), (30.0, -5.25), (12.2, -3.0), (10.0, 0.5), (3.0, 12.2)],
            [(40.0, 40.0), (-20.0, 30.0)],
        ),
        (
            "street",
            [(1.0, 0.0), (10.0, 0.0), (55.0, 0.0), (65.0, 1.0)],
            [(5.0, 0.0), (0.0, -1.75), (0.0, 1.75), (55.0, 0.5), (60.0, 0.0), (61.5, 30.0)],
            [(0.0, 30.0), (120.0, -20.0)],
        ),
        (
            "sandbox",
            [(0.431, 0.0), (0.225, 0.8975), (-0.225, 2.3025), (-0.6525, 1.35)],
            [(0.225, 0.0), (0.0, 1.6), (0.95, -3.0), (-1.5, -3.0), (-0.225, 0.8975)],
            [(1.5, 0.5), (-1.0, -0.8), (1.8, -4.5)],
        ),
    ],
)
def test_roads_are_dark_markings_white_and_lawns_green(
    world: World, white: list[tuple[float, float]], dark: list[tuple[float, float]], green: list[tuple[float, float]]
) -> None:
    paint, paint_reflectivity = ground(world, white)
    road, road_reflectivity = ground(world, dark)
    lawn, _ = ground(world, green)
    assert paint.min() > 0.5
    assert road.max() < 0.2
    assert (np.ptp(road, axis=1) < 0.03).all()  # grey
    assert (lawn[:, [1]] > 1.3 * lawn[:, [0, 2]]).all()
    assert paint_reflectivity.min() > 2.5 * road_reflectivity.max()


@pytest.mark.parametrize("texture", get_args(Texture))
def test_every_texture_is_drawn_near_the_colour_of_its_material(texture: Texture) -> None:
    material = Material("m", (0.6, 0.5, 0.4), 0.5, texture=texture)
    generator = np.random.default_rng(7)
    local, side = generator.uniform(-50, 50, (5000, 3)), np.tile([[0.6, -0.8, 0.0]], (5000, 1))
    rgb = surface_rgb([material], np.zeros(5000, np.int64), local, side)
    assert (rgb.dtype.name, rgb.shape) == ("float32", (5000, 3))
    assert ((rgb >= 0) & (rgb <= 1)).all()
    reflectivity = surface_reflectivity([material], np.zeros(5000, np.int64), local, side)
    assert (reflectivity.dtype.name, reflectivity.shape) == ("float32", (5000,))
    assert (reflectivity >= 0).all()
    if texture == "plain":
        np.testing.assert_allclose(rgb, np.tile(linear(material.rgb), (5000, 1)), rtol=1e-6)
        np.testing.assert_allclose(reflectivity, 0.5)
    else:
        assert rgb.std(0).min() > 0.002
    assert texture == "plain" or texture in TEXTURES
