"""Forms of things in unit size, to be stretched: x and y in [-0.5, 0.5], z in [0, 1]."""

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np

from lidcam.bags.simulator.world.bodies.cyclist import bicycle
from lidcam.bags.simulator.world.meshes.mesh import Material, Mesh, box, cylinder, merged, sphere
from lidcam.pipeline.core.arrays import F64

VARIANTS = 8
"""Different meshes of each form that is drawn."""

PLAIN = Material("thing", (0.5, 0.5, 0.5))
"""To be replaced by the material of each thing."""
BARK = Material("bark", (0.34, 0.27, 0.21), 0.35, texture="bark")


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


def _ball(draw: np.random.Generator, count: int, low: float, high: float, *, hollow: float = 0.5) -> F64:
    """Places (N, 3) in an ellipsoid between two heights, mostly in its outer shell."""
    away = draw.standard_normal((count, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    away *= draw.uniform(hollow, 1.0, (count, 1)) * 0.5
    # Boughs: a few lumps on the shell make it irregular.
    lumps = draw.standard_normal((6, 3))
    lumps /= np.linalg.norm(lumps, axis=1, keepdims=True)
    unit = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    away *= 0.7 + 0.3 * np.clip((unit @ lumps.T).max(1, keepdims=True), 0.0, 1.0) ** 2
    away[:, 2] = (low + high) / 2 + away[:, 2] * (high - low)
    return np.asarray(away)


def _tree(draw: np.random.Generator) -> Mesh:
    fork = draw.uniform(0.2, 0.4)
    trunk = cylinder((0, 0, 0), (0, 0, 0.7), draw.uniform(0.02, 0.05), BARK, sides=8, taper=0.6)
    return merged(trunk, _leaves(draw, _ball(draw, int(draw.integers(150, 500)), fork, 1.0, hollow=0.3), 0.09))


def _conifer(draw: np.random.Generator) -> Mesh:
    z = 1 - np.sqrt(draw.uniform(0, 1, 400)) * draw.uniform(0.85, 0.95)
    turn, out = draw.uniform(0, 2 * np.pi, 400), 0.5 * (1 - z) * draw.uniform(0.4, 1.0, 400)
    places = np.stack([out * np.cos(turn), out * np.sin(turn), z], 1)
    return merged(cylinder((0, 0, 0), (0, 0, 0.8), 0.04, BARK, sides=8), _leaves(draw, places, 0.07))


def _bush(draw: np.random.Generator) -> Mesh:
    return _leaves(
        draw,
        _ball(draw, int(draw.integers(50, 260)), draw.uniform(-0.4, 0.1), 1.0, hollow=draw.uniform(0.2, 0.7)),
        0.11,
    )


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
