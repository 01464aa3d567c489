"""The colour and reflectivity of surface points, from materials and their textures.

A texture gives each point one of a few looks (a road: asphalt, white paint, grass...) and a brightness factor. A look
has its own colour and reflectivity, or the material's. Points are in the frame of the thing; textures other than
`plain` are meant for the static world, where that is the world frame. The ground of a world is one texture: roads,
markings and grass as functions of x and y, over seamless noise images.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial

import numpy as np

from lidcam.bags.simulator.world.mesh import OWN, Look, Material, Rgb, Texture
from lidcam.pipeline.core.arrays import F32, F64, I64, U8, Bools

Floats = F32 | F64
Drawn = tuple[U8, F32]

ASPHALT, WHITE, GRASS, PATCH, DRAIN = range(5)  # rows of `GROUND_LOOKS`
PAINT, LAWN = Look((0.90, 0.90, 0.87), 0.75), Look((0.36, 0.46, 0.24), 0.45)
GROUND_LOOKS = (OWN, PAINT, LAWN, Look((0.29, 0.29, 0.30), 0.14), Look((0.20, 0.20, 0.20), 0.20))
ROUGHNESS = np.array([0.06, 0.04, 0.15, 0.05, 0.1], np.float32)
SIZE = 512  # a power of two: positions wrap by masking bits
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


def grain(u: F32, v: F32, cell_m: float) -> F32:
    """Noise (N,) of mean 0 and standard deviation 1, at all scales from one cell to 200 cells."""
    return _look_up(_cloudy(), u * np.float32(1 / cell_m), v * np.float32(1 / cell_m))


def cells(u: F32, v: F32) -> F32:
    """Independent values (N,) in [-1, 1), one per unit square."""
    return _look_up(_white(), u, v)


def _look_up(image: F32, u: F32, v: F32) -> F32:
    # Adding a whole number of periods makes the cast round down for negative positions, too.
    column, row = ((values + np.float32(1 << 20)).astype(np.int32) for values in (u, v))
    return np.asarray(image.take(((row & (SIZE - 1)) << 9) | (column & (SIZE - 1))))


@cache
def _white() -> F32:
    generator = np.random.Generator(np.random.PCG64(101))
    return generator.uniform(-1.0, 1.0, SIZE * SIZE).astype(np.float32)


@cache
def _cloudy() -> F32:
    return noise(102, lambda frequency: 1 / np.maximum(frequency, 1 / 200) ** 0.8).ravel().astype(np.float32)


def noise(seed: int, amplitude: Callable[[F64], F64]) -> F64:
    """Noise (`SIZE`, `SIZE`) of mean 0 and standard deviation 1 that tiles, with an amplitude by frequency per cell."""
    white = np.random.Generator(np.random.PCG64(seed)).standard_normal((SIZE, SIZE))
    share = amplitude(np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)))
    share[0, 0] = 0.0
    rough = np.fft.irfft2(np.fft.rfft2(white) * share, (SIZE, SIZE))
    return np.asarray(rough / rough.std())


def _dashes(along: F32, period: float, share: float) -> Bools:
    """Whether positions along a line lie in a dash."""
    turns = along * np.float32(1 / period)
    return np.asarray(turns - np.floor(turns) < share)


def _between(value: F32, low: float, high: float) -> Bools:
    return np.asarray((value > low) & (value < high))


def _painted(look: U8, x: F32, y: F32, cell_m: float, *, worn: float) -> Drawn:
    """Add grain, and wear the paint off in places."""
    rough = grain(x, y, cell_m)
    rubbed = (look == WHITE) & (rough > worn)
    look[rubbed] = ASPHALT
    return look, 1 + ROUGHNESS.take(look) * rough


def sandbox_ground(point: F32, _: F32) -> Drawn:
    """The table at about 1:14: an intersection, a roundabout and two starting bays for the cars."""
    x, y = point[:, 0], point[:, 1]
    radius = np.hypot(x, y + np.float32(3))
    beside_y, beside_x = np.abs(x), np.abs(y - np.float32(1.6))
    ring = _between(radius, 0.55, 1.35)
    road_y = (beside_y < 0.45) & (y > -1.9)
    road_x = beside_x < 0.5
    bays = _between(x, -1.80, -1.0) & _between(y, -4.25, -2.75)
    road = ring | road_y | road_x | (bays & (radius > 0.55))
    look = np.where(road, np.uint8(ASPHALT), np.uint8(GRASS))

    on_y = road_y & (beside_x > 0.5) & (radius > 1.35)
    on_x = road_x & (beside_y > 0.45)
    line = on_y & (beside_y > 0.425) & (beside_y < 0.438)
    line |= on_x & (beside_x > 0.475) & (beside_x < 0.488)
    free_y = on_y & (beside_x > 0.74) & (y > -1.5)
    free_x = on_x & (beside_y > 0.69)
    line |= free_y & (beside_y < 0.008) & _dashes(y, 0.30, 0.5)
    line |= free_x & (beside_x < 0.008) & _dashes(x, 0.30, 0.5)
    # Zebra crossings, then stop lines on the right-hand half of each arm.
    zebra_y = on_y & _between(beside_x, 0.53, 0.65) & (beside_y < 0.42)
    zebra_x = on_x & _between(beside_y, 0.48, 0.60) & (beside_x < 0.47)
    line |= zebra_y & _dashes(x + np.float32(0.0175), 0.07, 0.5)
    line |= zebra_x & _dashes(y - np.float32(1.5825), 0.07, 0.5)
    line |= on_y & _between(beside_x, 0.69, 0.715) & ((x > 0) == (y < 1.6)) & (beside_y < 0.425)
    line |= on_x & _between(beside_y, 0.64, 0.665) & ((y > 1.6) == (x > 0)) & (beside_x < 0.475)
    # The roundabout: edges and give-way lines.
    edge = _between(radius, 0.570, 0.583) | (_between(radius, 1.317, 1.330) & ~(road_y & (y > -3)))
    line |= ring & edge & ~(bays & (radius > 1.2))
    line |= road_y & _between(radius, 1.36, 1.385) & (x < 0) & _dashes(x, 0.06, 0.5)
    across_bay = np.abs(np.abs(y + np.float32(3.5)) - np.float32(0.5))
    line |= bays & (radius > 1.38) & (_between(across_bay, 0.20, 0.212) | (x < -1.785))
    look[line] = WHITE
    return _painted(look, x, y, 0.004, worn=3.0)


def crossing_ground(point: F32, _: F32) -> Drawn:
    """Two roads of two lanes each way, with turning areas beyond +-90 m."""
    x, y = point[:, 0], point[:, 1]
    far_x, far_y = np.abs(x), np.abs(y)
    # Distance along the arm that a point belongs to, and across it. The right-hand side of incoming traffic is the left
    # one seen from the middle.
    along_x = far_x > far_y
    along = np.where(along_x, far_x, far_y)
    across = np.where(along_x, y * np.sign(x), -x * np.sign(y))
    beside = np.abs(across)
    turning_place = _between(along, 93.0, 124.0) & (beside < 15.5)
    road = (beside < 7.6) | (along < 12) | turning_place
    look = np.where(road, np.uint8(ASPHALT), np.uint8(GRASS))
    arm = road & _between(along, 8.0, 90.0)
    line = arm & (along > 12.0) & _between(beside, 6.70, 6.82)
    lanes = arm & (along > 12.2) & _between(beside, 3.44, 3.56)
    line |= lanes & ((along < 32.0) | _dashes(along, 6.0, 0.5))
    line |= arm & (along > 12.0) & _between(beside, 0.06, 0.18)
    line |= arm & _between(along, 12.0, 12.4) & (across > 0.2) & (beside < 6.75)
    line |= arm & _between(along, 8.5, 11.5) & (beside < 6.9) & _dashes(across + np.float32(0.25), 1.0, 0.5)
    line |= arm & _arrows(along, across)
    look[line] = WHITE
    seam = arm & _between(along, 40.0, 58.0) & _between(across, -3.3, -0.6)
    look[seam & ~line] = PATCH
    _drain(look, along, beside - np.float32(6.9), 24.0, arm)
    return _painted(look, x, y, 0.03, worn=2.5)


def _arrows(along: F32, across: F32) -> Bools:
    """Straight-ahead arrows in the incoming lanes, pointing to the middle."""
    offset = np.abs(np.minimum(np.abs(across - np.float32(1.75)), np.abs(across - np.float32(5.25))))
    from_tip = along - np.float32(18.0)
    head = _between(from_tip, 0.0, 1.4) & (offset < from_tip * np.float32(0.38))
    shaft = _between(from_tip, 1.3, 4.5) & (offset < 0.10)
    return np.asarray((head | shaft) & (across > 0))


def street_ground(point: F32, _: F32) -> Drawn:
    """A town street along x with parking lanes, crossed by a side road at x = 60; turning areas at all ends."""
    x, y = point[:, 0], point[:, 1]
    beside, off = np.abs(y), np.abs(x - np.float32(60))
    from_ends = np.abs(x - np.float32(50))  # the street ends 200 m from its middle
    turning_place = _between(from_ends, 200.0, 246.0) & (beside < 19) | (off < 12) & _between(beside, 68.0, 94.0)
    road = (beside < 6.0) | (off < 3.9) | ((off < 8.5) & (beside < 9.5)) | turning_place
    look = np.where(road, np.uint8(ASPHALT), np.uint8(GRASS))
    main = (beside < 5.9) & (from_ends < 196)
    free = main & (off > 8.5)
    line = free & (beside < 0.06) & _dashes(x, 9.0, 1 / 3)
    line |= free & (off > 10.5) & _between(beside, 3.50, 3.60) & _dashes(x, 2.0, 0.5)
    # Bays of 6 m in the parking lanes.
    bay = x * np.float32(1 / 6.0)
    line |= free & (off > 10.5) & _between(beside, 3.6, 5.8) & ((bay - np.floor(bay)) < 0.017)
    # Give-way lines of the side road.
    line |= _between(off, 0.0, 3.4) & _between(beside, 3.65, 4.05) & (y * (x - 60) < 0) & _dashes(x, 0.75, 0.6)
    line |= (off < 0.06) & _between(beside, 11.0, 64.0) & _dashes(y, 9.0, 1 / 3)
    # Zebra crossings on both sides of the side road.
    line |= _between(off, 4.6, 7.6) & (beside < 5.7) & _dashes(y + np.float32(0.25), 1.0, 0.5)
    look[line] = WHITE
    patch = main & _between(x - np.float32(60) * np.floor(x / np.float32(60)), 20.0, 27.0) & _between(y, -3.2, -0.4)
    look[patch & ~line] = PATCH
    _drain(look, x, beside - np.float32(5.68), 20.0, main)
    return _painted(look, x, y, 0.03, worn=2.5)


def _drain(look: U8, along: F32, from_kerb: F32, period: float, road: Bools) -> None:
    """Gully grates beside the kerb."""
    place = along - np.float32(period) * np.floor(along * np.float32(1 / period))
    grate = road & (np.abs(from_kerb) < 0.22) & (place < 0.5)
    look[grate & _dashes(along, 0.08, 0.6)] = DRAIN


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
