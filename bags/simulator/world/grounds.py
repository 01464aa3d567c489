"""The ground of each world: roads, markings and grass as functions of x and y, over seamless noise images."""

from collections.abc import Callable
from functools import cache

import numpy as np

from lidcam.bags.simulator.world.mesh import OWN, Look
from lidcam.pipeline.core.arrays import F32, F64, U8, Bools

Drawn = tuple[U8, F32]

ASPHALT, WHITE, GRASS, PATCH, DRAIN = range(5)
PAINT, LAWN = Look((0.90, 0.90, 0.87), 0.75), Look((0.36, 0.46, 0.24), 0.45)
GROUND_LOOKS = (OWN, PAINT, LAWN, Look((0.29, 0.29, 0.30), 0.14), Look((0.20, 0.20, 0.20), 0.20))
ROUGHNESS = np.array([0.06, 0.04, 0.15, 0.05, 0.1], np.float32)
SIZE = 512  # a power of two: positions wrap by masking bits


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
