"""Open worlds: uneven ground with straight roads, and the things of a scenario on it.

The forms of things are made in unit size, to be stretched: x and y in [-0.5, 0.5], z in [0, 1].
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from zlib import crc32

import numpy as np

from lidcam.bags.simulator.scenario.scenario import GroundScenario, ThingScenario
from lidcam.bags.simulator.world.bodies.people import bicycle
from lidcam.bags.simulator.world.mesh import Material, Mesh, box, cylinder, merged, sphere
from lidcam.bags.simulator.world.places.furniture import BARK
from lidcam.pipeline.core.arrays import F64, Bools

ASPHALT = Material("asphalt", (0.30, 0.30, 0.31), 0.18, texture="asphalt")
VERGE = Material("verge", (0.36, 0.46, 0.24), 0.4, texture="grass")
NODES, FINE_SHARE = 111, 0.15
"""Nodes of the ground along each axis; half of them lie within this share of its reach, where sensors are."""
KERB = 0.01  # width of a kerb as a share of half the road; of roads along x and y, of others the distance of nodes
VARIANTS = 8  # different meshes of each form that is drawn
PLAIN = Material("thing", (0.5, 0.5, 0.5))  # to be replaced by the material of each thing


@cache
def form(kind: str, variant: int) -> Mesh:
    """One of the `VARIANTS` meshes of a kind of thing (`ThingScenario`); they differ only where they are irregular."""
    return FORMS[kind](np.random.Generator(np.random.PCG64(variant)))


def _leaves(draw: np.random.Generator, places: F64, size: F64 | float, *, upright: bool = False) -> Mesh:
    """A triangle of random direction around each place (N, 3); `size` is its extent in unit lengths."""
    corners = draw.standard_normal((len(places), 3, 3))
    corners *= np.asarray(size, np.float64).reshape(-1, 1, 1) / 2
    if upright:
        corners[:, 0, 2] = np.abs(corners[:, 0, 2]) * 4
    vertices = (places[:, None] + corners).reshape(-1, 3)
    vertices = np.clip(vertices, (-0.5, -0.5, 0.0), (0.5, 0.5, 1.0))
    count = len(places)
    return Mesh(vertices, np.arange(3 * count).reshape(-1, 3), np.zeros(count, np.int64), (PLAIN,))


def _ball(draw: np.random.Generator, count: int, low: float, *, hollow: float) -> F64:
    """Places (N, 3) in an ellipsoid between a height and 1, mostly in its outer shell."""
    away = draw.standard_normal((count, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    away *= draw.uniform(hollow, 1.0, (count, 1)) * 0.5
    # Boughs: a few lumps on the shell make it irregular.
    lumps = draw.standard_normal((6, 3))
    lumps /= np.linalg.norm(lumps, axis=1, keepdims=True)
    unit = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    away *= 0.7 + 0.3 * np.clip((unit @ lumps.T).max(1, keepdims=True), 0.0, 1.0) ** 2
    away[:, 2] = (low + 1) / 2 + away[:, 2] * (1 - low)
    return np.asarray(away)


def _tree(draw: np.random.Generator) -> Mesh:
    fork = draw.uniform(0.2, 0.4)
    trunk = cylinder((0, 0, 0), (0, 0, 0.7), draw.uniform(0.02, 0.05), BARK, sides=8, taper=0.6)
    return merged(trunk, _leaves(draw, _ball(draw, int(draw.integers(150, 500)), fork, hollow=0.3), 0.09))


def _conifer(draw: np.random.Generator) -> Mesh:
    z = 1 - np.sqrt(draw.uniform(0, 1, 400)) * draw.uniform(0.85, 0.95)
    turn, out = draw.uniform(0, 2 * np.pi, 400), 0.5 * (1 - z) * draw.uniform(0.4, 1.0, 400)
    places = np.stack([out * np.cos(turn), out * np.sin(turn), z], 1)
    return merged(cylinder((0, 0, 0), (0, 0, 0.8), 0.04, BARK, sides=8), _leaves(draw, places, 0.07))


def _bush(draw: np.random.Generator) -> Mesh:
    count, low, hollow = int(draw.integers(50, 260)), draw.uniform(-0.4, 0.1), draw.uniform(0.2, 0.7)
    return _leaves(draw, _ball(draw, count, low, hollow=hollow), 0.11)


def _hedge(draw: np.random.Generator) -> Mesh:
    count = int(draw.integers(150, 420))
    places = draw.uniform((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0), (count, 3))
    side = draw.integers(0, 3, count)  # near the long sides and the top
    places[side == 0, 1] = -0.5 + np.abs(draw.normal(0, 0.12, (side == 0).sum()))
    places[side == 1, 1] = 0.5 - np.abs(draw.normal(0, 0.12, (side == 1).sum()))
    places[side == 2, 2] = 1 - np.abs(draw.normal(0, 0.08, (side == 2).sum()))
    core = box((0, 0, 0.4), (0.98, 0.4, 0.8), PLAIN)
    return merged(core, _leaves(draw, places, 0.1))


def _grass(draw: np.random.Generator) -> Mesh:
    places = np.c_[draw.uniform(-0.5, 0.5, (160, 2)), np.zeros(160)]
    places[:, :2] += 0.15 * draw.standard_normal((160, 2))
    return _leaves(draw, places, draw.uniform(0.05, 0.3, 160), upright=True)


def _lump(draw: np.random.Generator) -> Mesh:
    ball = sphere((0, 0, 0.3), 0.5, PLAIN, sides=12)
    vertices = ball.vertices * draw.uniform(0.75, 1.0, (len(ball.vertices), 1))
    vertices[:, 2] = np.clip(vertices[:, 2] * 1.3, 0.0, 1.0)
    return Mesh(vertices, ball.triangles, ball.materials, ball.palette)


def _fence(draw: np.random.Generator) -> Mesh:
    bars = int(draw.integers(6, 30))
    rails = [box((0, 0, z), (1.0, 0.6, 0.05), PLAIN) for z in draw.uniform(0.1, 0.95, int(draw.integers(1, 4)))]
    width = draw.uniform(0.2, 0.8) / bars
    posts = [box((x, 0, 0.5), (width, 1.0, 1.0), PLAIN) for x in np.linspace(-0.5 + width, 0.5 - width, bars)]
    return merged(*rails, *posts)


def _table(draw: np.random.Generator) -> Mesh:
    legs = [box((x, y, 0.45), (0.05, 0.08, 0.9), PLAIN) for x in (-0.45, 0.45) for y in (-0.4, 0.4)]
    back = [box((-0.47, 0, 0.9), (0.05, 0.9, 0.2), PLAIN)] if draw.random() < 0.5 else []
    return merged(box((0, 0, draw.uniform(0.5, 0.95)), (1.0, 1.0, 0.05), PLAIN), *legs, *back)


def _bicycle(_: np.random.Generator) -> Mesh:
    body = bicycle()
    low, high = body.bounds
    middle = np.array([*(low + high)[:2] / 2, low[2]])
    return Mesh((body.vertices - middle) / (high - low), body.triangles, body.materials, body.palette)


FORMS: Mapping[str, Callable[[np.random.Generator], Mesh]] = {
    "box": lambda _: box((0, 0, 0.5), (1, 1, 1), PLAIN),
    "cylinder": lambda _: cylinder((0, 0, 0), (0, 0, 1), 0.5, PLAIN, sides=12),
    "cone": lambda _: cylinder((0, 0, 0), (0, 0, 1), 0.5, PLAIN, sides=12, taper=0.15),
    "lump": _lump,
    "fence": _fence,
    "table": _table,
    "bicycle": _bicycle,
    "tree": _tree,
    "conifer": _conifer,
    "bush": _bush,
    "hedge": _hedge,
    "grass": _grass,
}


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
        beside = np.abs(off @ [-along[1], along[0]]) <= road.width_m / 2 + slack
        on |= beside & (np.abs(off @ along - length / 2) <= length / 2)
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
