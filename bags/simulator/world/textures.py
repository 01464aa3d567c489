"""The colour and reflectivity of surface points, from materials and their textures.

A texture gives each point one of a few looks (a road: asphalt, white paint, grass...) and a brightness factor. A look
has its own colour and reflectivity, or the material's. Points are in the frame of the thing; textures other than
`plain` are meant for the static world, where that is the world frame.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from lidcam.bags.simulator.world.grounds import (
    GROUND_LOOKS,
    cells,
    crossing_ground,
    grain,
    sandbox_ground,
    street_ground,
)
from lidcam.bags.simulator.world.mesh import OWN, Look, Material, Rgb, Texture
from lidcam.pipeline.core.arrays import F32, F64, I64, U8

Floats = F32 | F64
Drawn = tuple[U8, F32]

WINDOW = Look((0.21, 0.26, 0.32), 0.08)
FRAME = Look((0.88, 0.87, 0.84), 0.5)
DOOR = Look((0.30, 0.20, 0.14), 0.25)
PLINTH = Look((0.42, 0.41, 0.40), 0.3)
MORTAR = Look((0.62, 0.59, 0.55), 0.35)
ROOF = Look((0.40, 0.39, 0.38), 0.25)


def surface_rgb(palette: Sequence[Material], material: I64, local: Floats, normal: Floats) -> F32:
    """Linear-light albedo (N, 3) of surface points.

    `material` (N,) are rows of the palette, points and normals (N, 3) in the frame of the thing hit.
    """
    table = _table(tuple(palette))
    rows, shade = _drawn(table, material, local, normal)
    return np.asarray(np.clip(table.rgb.take(rows, axis=0) * shade[:, None], 0.0, 1.0), np.float32)


def surface_reflectivity(palette: Sequence[Material], material: I64, local: Floats, normal: Floats) -> F32:
    """Reflectivity (N,) at 905 nm of surface points, see `Material`; arguments as for `surface_rgb`."""
    table = _table(tuple(palette))
    rows, shade = _drawn(table, material, local, normal)
    return np.asarray(table.reflectivity.take(rows) * (0.5 + 0.5 * shade), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """A palette as arrays."""

    textures: tuple[Texture, ...]  # names of its textures
    texture: U8  # (P,) rows of `textures`
    rgb: F32  # (P * MAX_LOOKS, 3) linear light
    reflectivity: F32  # (P * MAX_LOOKS,)


@lru_cache(maxsize=16)  # a camera calls it many times for few points
def _table(palette: tuple[Material, ...]) -> _Table:
    textures = tuple(dict.fromkeys(item.texture for item in palette))
    entries = [(item, look) for item in palette for look in _looks(item)]
    reflectivity = [item.reflectivity if look.reflectivity is None else look.reflectivity for item, look in entries]
    return _Table(
        textures,
        np.array([textures.index(item.texture) for item in palette], np.uint8),
        np.array([linear(look.rgb or item.rgb) for item, look in entries], np.float32).reshape(-1, 3),
        np.array(reflectivity, np.float32),
    )


def _drawn(table: _Table, material: I64, local: Floats, normal: Floats) -> tuple[I64, F32]:
    """Rows (N,) of the table (palette x looks), and brightness factors (N,)."""
    rows = material * MAX_LOOKS
    shade = np.ones(len(material), np.float32)
    textures = table.texture.take(material)
    for index in np.flatnonzero(np.bincount(textures, minlength=len(table.textures))):
        texture = table.textures[index]
        if texture == "plain":
            continue
        here = np.flatnonzero(textures == index)
        # Single precision: 0.03 mm at the far ends of the largest world. By column, as textures use whole coordinates.
        point = np.asarray(local.take(here, axis=0), np.float32, order="F")
        face = np.asarray(normal.take(here, axis=0), np.float32, order="F")
        look, light = TEXTURES[texture].draw(point, face)
        rows[here] += look
        shade[here] = light
    return rows, shade


def _looks(material: Material) -> tuple[Look, ...]:
    """The looks of a material's texture, padded to the width of the table."""
    looks = TEXTURES[material.texture].looks if material.texture != "plain" else (OWN,)
    return looks + (OWN,) * (MAX_LOOKS - len(looks))


def linear(rgb: Rgb) -> Rgb:
    """Linear light of an sRGB colour (IEC 61966-2-1)."""
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb)
    return red, green, blue


# --- textures: from points (n, 3) and normals (n, 3) to looks (n,) and brightness factors (n,)


def _walls(point: F32, normal: F32) -> tuple[F32, F32]:
    """Coordinates on a wall, along and up; x and y on level faces."""
    x, y, z = point.T
    flat = np.abs(normal[:, 2]) > 0.7
    along = np.where(flat, x, normal[:, 0] * y - normal[:, 1] * x)
    return along, np.where(flat, y, z)


def _rough(point: F32, normal: F32, *, cell_m: float, strength: float) -> Drawn:
    u, v = _walls(point, normal)
    return np.zeros(len(point), np.uint8), 1 + strength * grain(u, v, cell_m)


def _foliage(point: F32, normal: F32) -> Drawn:
    x, y, z = point.T
    tilt = np.abs(normal)
    flat, sideways = tilt[:, 2] > 0.6, tilt[:, 0] > tilt[:, 1]
    u, v = np.where(sideways & ~flat, y, x), np.where(flat, y, z)
    light = 1 + 0.22 * grain(u, v, 0.04) + 0.38 * cells(u * 11 + v * 3, v * 11 - u * 3)
    return np.zeros(len(point), np.uint8), np.maximum(light, 0.2)


def _paving(point: F32, normal: F32) -> Drawn:
    u, v = _walls(point, normal)
    row = v / np.float32(0.4)
    slab = u / np.float32(0.4) + np.float32(0.5) * (np.floor(row) % 2)
    joint = (slab - np.floor(slab) < 0.03) | (row - np.floor(row) < 0.03)
    light = 1 + 0.07 * cells(slab, row) + 0.05 * grain(u, v, 0.03)
    return np.zeros(len(point), np.uint8), np.where(joint, 0.55 * light, light)


def _brick(point: F32, normal: F32) -> Drawn:
    u, v = _walls(point, normal)
    row = v / np.float32(0.083)
    stone = u / np.float32(0.25) + np.float32(0.5) * (np.floor(row) % 2)
    mortar = (stone - np.floor(stone) < 0.05) | (row - np.floor(row) < 0.14)
    light = 1 + 0.20 * cells(stone, row) + 0.06 * grain(u, v, 0.03)
    return mortar.astype(np.uint8), np.where(mortar, np.float32(1), light)


def _roof(point: F32, normal: F32) -> Drawn:
    x, y, z = point.T
    u = np.where(np.abs(normal[:, 0]) > np.abs(normal[:, 1]), y, x)
    row, tile = z / np.float32(0.22), u / np.float32(0.25)
    step, across = row - np.floor(row), tile - np.floor(tile)
    light = (0.78 + 0.3 * step) * (0.85 + 0.3 * np.sin(np.pi * across)) * (1 + 0.10 * cells(tile, row))
    return np.zeros(len(point), np.uint8), light.astype(np.float32)


def _wood(point: F32, normal: F32) -> Drawn:
    u, v = _walls(point, normal)
    plank = v / np.float32(0.03)
    gap = plank - np.floor(plank) < 0.07
    light = 1 + 0.10 * cells(np.floor(plank), np.zeros_like(plank)) + 0.08 * grain(u * 0.12, v, 0.0016)
    return np.zeros(len(point), np.uint8), np.where(gap, 0.6 * light, light)


def _bark(point: F32, _: F32) -> Drawn:
    x, y, z = point.T
    return np.zeros(len(point), np.uint8), 1 + 0.35 * grain(2.0 * (x + y), 0.25 * z, 0.02)


def _facade(point: F32, normal: F32, *, scale: float) -> Drawn:
    """Rows of windows with frames and sills in a plastered wall, with doors and a plinth."""
    u, v = _walls(point, normal)
    u, v = u / np.float32(scale), v / np.float32(scale)
    flat = np.abs(normal[:, 2]) > 0.7
    bay, storey = u / np.float32(2.6), (v - np.float32(0.1)) / np.float32(2.9)
    left = (bay - np.floor(bay) - np.float32(0.5)) * np.float32(2.6)
    up = (storey - np.floor(storey)) * np.float32(2.9)
    outer, inner = np.abs(left) < 0.66, np.abs(left) < 0.58
    bar = (np.abs(left) < 0.035) | (np.abs(up - 1.95) < 0.03)
    opening = outer & (up > 0.85) & (up < 2.42)
    glass = inner & (up > 0.93) & (up < 2.34) & ~bar
    ground = v < 3.0
    door = ground & (np.floor(bay) % 4 == 0) & (np.abs(left) < 0.60) & (up < 2.3)
    look = np.zeros(len(point), np.uint8)
    look[opening | (outer & (up > 0.78) & (up < 0.86))] = 2
    look[glass] = 1
    look[v < 0.55] = 4
    look[door] = 3
    look[flat] = 5
    light: F32 = 1 + 0.05 * grain(u, v, 0.04)
    # Curtains, blinds or dark rooms behind the panes.
    room = cells(bay, storey)
    light = np.where(glass & ~door, np.where(room > 0.55, np.float32(2.6), 1 + np.float32(0.4) * room), light)
    return look, np.where(door, np.where(np.abs(np.abs(left) - 0.3) < 0.2, np.float32(0.85), np.float32(1)), light)


def _glass_front(point: F32, normal: F32) -> Drawn:
    """An office front: bands of glass between spandrels."""
    u, v = _walls(point, normal)
    flat = np.abs(normal[:, 2]) > 0.7
    pane, storey = u / np.float32(1.5), (v - np.float32(0.4)) / np.float32(3.4)
    up, across = storey - np.floor(storey), pane - np.floor(pane)
    glass = (up > 0.24) & (v > 0.4)
    post = (across < 0.05) | (np.abs(up - 0.80) < 0.012)
    look = np.zeros(len(point), np.uint8)
    look[glass] = 1
    look[glass & post] = 2
    look[flat] = 5
    light = 1 + 0.04 * grain(u, v, 0.05)
    room = cells(pane, storey)
    return look, np.where(glass & ~post, 1.6 + 0.5 * room, light)


HOUSE_LOOKS = (OWN, WINDOW, FRAME, DOOR, PLINTH, ROOF)


@dataclass(frozen=True, slots=True)
class _Drawing:
    draw: Callable[[F32, F32], Drawn]
    looks: tuple[Look, ...] = (OWN,)


TEXTURES: Mapping[Texture, _Drawing] = {
    "asphalt": _Drawing(partial(_rough, cell_m=0.03, strength=0.07)),
    "bark": _Drawing(_bark),
    "brick": _Drawing(_brick, (OWN, MORTAR)),
    "concrete": _Drawing(partial(_rough, cell_m=0.03, strength=0.06)),
    "crossing": _Drawing(crossing_ground, GROUND_LOOKS),
    "facade": _Drawing(partial(_facade, scale=1.0), HOUSE_LOOKS),
    "foliage": _Drawing(_foliage),
    "glass_front": _Drawing(_glass_front, HOUSE_LOOKS),
    "grass": _Drawing(partial(_rough, cell_m=0.05, strength=0.16)),
    "model_front": _Drawing(partial(_facade, scale=1 / 20), HOUSE_LOOKS),
    "paving": _Drawing(_paving),
    "roof": _Drawing(_roof),
    "sandbox": _Drawing(sandbox_ground, GROUND_LOOKS),
    "street": _Drawing(street_ground, GROUND_LOOKS),
    "wood": _Drawing(_wood),
}
MAX_LOOKS = max(len(drawing.looks) for drawing in TEXTURES.values())
