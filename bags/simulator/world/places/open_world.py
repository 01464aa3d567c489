"""Open worlds: uneven ground with straight roads, and the things of a scenario on it."""

from collections.abc import Sequence
from zlib import crc32

import numpy as np

from lidcam.bags.simulator.scenario.open_world import GroundScenario, ThingScenario
from lidcam.bags.simulator.world.meshes.mesh import Material, Mesh, merged
from lidcam.bags.simulator.world.places.forms import PLAIN, VARIANTS, form
from lidcam.pipeline.core.arrays import F64, Bools

ASPHALT = Material("asphalt", (0.30, 0.30, 0.31), 0.18, texture="asphalt")
VERGE = Material("verge", (0.36, 0.46, 0.24), 0.4, texture="grass")
NODES, FINE_SHARE = 111, 0.15
"""Nodes of the ground along each axis; half of them lie within this share of its reach, where sensors are."""
KERB = 0.01
"""Width of a kerb as a share of half the road; of roads along x and y, of others the distance of nodes."""


def open_mesh(ground: GroundScenario, things: Sequence[ThingScenario]) -> Mesh:
    """The static mesh of an open world."""
    places = np.array([thing.position_m for thing in things], np.float64).reshape(-1, 2)
    heights = open_height(ground, places)
    return merged(_ground(ground), *(_placed(thing, z) for thing, z in zip(things, heights.tolist(), strict=True)))


def open_height(ground: GroundScenario, xy: F64) -> F64:
    """Heights (N,) of the ground at positions (N, 2), without its small bumps; 0 on a road at the origin."""
    heights = xy @ np.array(ground.slope)
    if ground.waves_m:
        draw = np.random.Generator(np.random.PCG64(ground.seed))
        for _ in range(3):
            turn, phase, stretch = draw.uniform((0, 0, 0.7), (2 * np.pi, 2 * np.pi, 1.6)).tolist()
            along = xy @ np.array([np.cos(turn), np.sin(turn)]) * (2 * np.pi / (ground.wave_length_m * stretch))
            heights = heights + ground.waves_m / 3 * (np.sin(along + phase) - np.sin(phase))
    if ground.roads and ground.kerb_m:
        heights = heights + np.where(_on_road(ground, xy), 0.0, ground.kerb_m)
    return np.asarray(heights)


def _on_road(ground: GroundScenario, xy: F64) -> Bools:
    on = np.zeros(len(xy), np.bool_)
    slack = 1e-9  # a node at the kerb is on the road
    for road in ground.roads:
        begin, end = np.array(road.from_m), np.array(road.to_m)
        length = float(np.hypot(*(end - begin)))
        along = (end - begin) / max(length, 1e-9)
        off = xy - begin
        on |= (np.abs(off @ [-along[1], along[0]]) <= road.width_m / 2 + slack) & (
            np.abs(off @ along - length / 2) <= length / 2
        )
    return on


def _ground(ground: GroundScenario) -> Mesh:
    along_x, along_y = _nodes(ground, 0), _nodes(ground, 1)
    x, y = (grid.ravel() for grid in np.meshgrid(along_x, along_y, indexing="ij"))
    xy = np.stack([x, y], 1)
    heights, road = open_height(ground, xy), _on_road(ground, xy)
    if ground.roughness_m:
        bumps = np.random.Generator(np.random.PCG64(ground.seed + 1)).normal(0, ground.roughness_m, len(xy))
        heights = heights + np.where(road, 0.25, 1.0) * bumps
    rows = len(along_y)
    a = (np.arange(len(along_x) - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
    b, c, d = a + rows, a + rows + 1, a + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    materials = np.tile(np.where(road[a] & road[c], 0, 1), 2)
    return Mesh(np.c_[xy, heights], triangles, materials, (ASPHALT, VERGE))


def _nodes(ground: GroundScenario, axis: int) -> F64:
    """Coordinates of the nodes of the ground along an axis, two of them at each kerb that runs across it."""
    share = np.linspace(-1, 1, NODES)
    places = [ground.reach_m * (2 * FINE_SHARE * share + (1 - 2 * FINE_SHARE) * share**3)]
    for road in ground.roads:
        middle, end = road.from_m[axis], road.to_m[axis]
        if middle == end:
            places.append(middle + (road.width_m / 2) * np.array([-1 - KERB, -1, 1, 1 + KERB]))
    return np.unique(np.concatenate(places).clip(-ground.reach_m, ground.reach_m))


def _placed(thing: ThingScenario, ground_m: float) -> Mesh:
    """The mesh of a thing; its place decides on the variant of its form."""
    unit = form(thing.kind, crc32(np.array(thing.position_m).tobytes()) % VARIANTS)
    look = Material(thing.kind, thing.color, thing.reflectivity)
    palette = tuple(look if material is PLAIN else material for material in unit.palette)
    turn = np.deg2rad(thing.yaw_deg)
    stretched = Mesh(unit.vertices * thing.size_m, unit.triangles, unit.materials, palette)
    return stretched.moved((*thing.position_m, ground_m + thing.bottom_m), yaw=float(turn))
