"""The table at about 1:14: an intersection, a roundabout, low walls, model houses and trees, sensor masts.

No body encloses the origin of a sensor; sensor positions are those of the predecessor system. The four cameras of
each group look along the axes and see 32 degrees to each side; the masts stand on the diagonals between them.
"""

import numpy as np
import numpy.typing as npt

from lidcam.bags.simulator.world.mesh import DARK, METAL, Material, Mesh, box, cylinder, merged, polygon
from lidcam.bags.simulator.world.places.furniture import conifer, house

TABLE = (-2.0, 2.0, -5.0, 2.9)  # x from, x to, y from, y to
FLOOR_Z_M = -0.78
ROOM = (-6.0, 6.0, -9.0, 7.0)

GROUND = Material("table top", (0.33, 0.33, 0.35), 0.25, texture="sandbox")
WOOD = Material("table wood", (0.60, 0.44, 0.29), 0.40, texture="wood")
WALL = Material("low wall", (0.58, 0.46, 0.36), 0.40, texture="wood")
FLOOR = Material("room floor", (0.46, 0.43, 0.40), 0.35, texture="concrete")
POLE = Material("mast", (0.30, 0.31, 0.34), 0.30, mirror=0.03)
ISLAND = Material("island", (0.30, 0.42, 0.22), 0.45, texture="grass")
KERB = Material("model kerb", (0.66, 0.65, 0.62), 0.45, texture="concrete")
HOUSING = Material("sensor housing", (0.22, 0.23, 0.26), 0.2, mirror=0.04)

# Positions in the site frame, and viewing directions (degrees from +x) of the cameras.
LIDAR_1, LIDAR_2, LIDAR_3 = (-0.5574, 1.2543, 0.256), (0.4325, 0.2644, 0.256), (0.001, -0.9893, 0.4418)
NORTH_CAMERAS = (
    ((-0.143, 0.371, 0.393), 90.0),
    ((0.05, 0.70, 0.393), -90.0),
    ((0.198, 0.549, 0.401), 180.0),
    ((-0.291, 0.856, 0.439), 0.0),
)
SOUTH_CAMERAS = (
    ((0.0, -1.109, 0.335), -90.0),
    ((0.094, -1.0, 0.335), 0.0),
    ((0.0, -0.906, 0.335), 90.0),
    ((-0.094, -1.0, 0.335), 180.0),
)


def sandbox() -> Mesh:
    """The static mesh of the table and the room around it."""
    x0, x1, y0, y1 = TABLE
    board = box(((x0 + x1) / 2, (y0 + y1) / 2, -0.031), (x1 - x0, y1 - y0, 0.06), WOOD)
    legs = [
        box((x, y, (FLOOR_Z_M - 0.06) / 2), (0.08, 0.08, -FLOOR_Z_M - 0.06), WOOD)
        for x in (x0 + 0.1, x1 - 0.1)
        for y in (y0 + 0.1, (y0 + y1) / 2, y1 - 0.1)
    ]
    walls = [
        box((-1.98, -1.05, 0.06), (0.04, 7.9, 0.12), WALL),
        box((1.98, -1.05, 0.06), (0.04, 7.9, 0.12), WALL),
        box((0.0, -4.98, 0.06), (4.0, 0.04, 0.12), WALL),
        box((0.0, 2.88, 0.06), (4.0, 0.04, 0.12), WALL),
    ]
    top, floor = _level(TABLE, 0.0, GROUND), _level(ROOM, FLOOR_Z_M, FLOOR)
    return merged(top, board, *legs, *walls, floor, *_buildings(), *_island(), *_trees(), *_masts())


def _level(bounds: tuple[float, float, float, float], z: float, material: Material) -> Mesh:
    x0, x1, y0, y1 = bounds
    return polygon([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)], material)


def _buildings() -> list[Mesh]:
    """Model houses; their walls lie on multiples of a facade bay, 0.13 m."""
    houses = [
        ((0.91, 2.21), (1.69, 2.73), 0.44, (0.72, 0.60, 0.42), None, True),
        ((-1.69, 2.21), (-1.04, 2.73), 0.30, (0.42, 0.52, 0.60), 2, True),
        ((1.17, -0.91), (1.82, -0.26), 0.30, (0.62, 0.38, 0.34), 0, False),
        ((-1.82, -1.56), (-1.30, -0.91), 0.44, (0.75, 0.66, 0.50), None, True),
        ((1.30, -4.81), (1.82, -4.29), 0.30, (0.66, 0.64, 0.58), 1, True),
    ]
    parts = []
    for low, high, height, wall, roof, along in houses:
        # Built at twenty times its size: roofs have the proportions of real houses.
        corners = [20 * v for v in low], [20 * v for v in high]
        big = house(*corners, 20 * height, wall, texture="model_front", roof=roof, ridge_along_x=along)
        parts.append(big.moved(scale=1 / 20))
    return parts


def _island() -> list[Mesh]:
    return [
        cylinder((0, -3, -0.01), (0, -3, 0.018), 0.54, KERB, sides=40),
        cylinder((0, -3, -0.01), (0, -3, 0.024), 0.515, ISLAND, sides=40),
        cylinder((0, -3, 0.0), (0, -3, 0.06), 0.34, ISLAND, sides=32, taper=0.75),
        conifer(0.0, -3.0, 0.26, base=0.05),
        conifer(0.14, -2.90, 0.17, base=0.05),
        conifer(-0.12, -3.10, 0.19, base=0.05),
    ]


def _trees() -> list[Mesh]:
    places = [
        (-1.80, 0.62, 0.24), (-1.45, 0.40, 0.20), (-1.05, 0.72, 0.22), (-1.80, -0.30, 0.26), (-1.40, -0.45, 0.21),
        (0.80, 0.80, 0.20), (1.75, 0.75, 0.25), (1.40, 0.45, 0.22), (0.85, -1.15, 0.21), (1.75, -1.70, 0.26),
        (-0.95, -1.55, 0.20), (-1.80, -2.20, 0.24), (1.72, -3.30, 0.24), (1.60, -2.60, 0.20), (-0.90, -4.72, 0.22),
        (0.75, -4.70, 0.24), (0.62, 2.70, 0.20), (-0.75, 2.55, 0.23), (-1.85, 2.65, 0.20),
    ]  # fmt: skip
    return [conifer(x, y, height) for x, y, height in places]


def _masts() -> list[Mesh]:
    """Two masts with arms over the road, a pole, and the sensor housings."""
    north, south = (-0.62, 0.98), (0.60, -1.60)
    parts = [
        *_post(*north, 0.535),
        *_post(*south, 0.31),
        *_post(LIDAR_2[0], LIDAR_2[1], 0.205),
        _bar((*north, 0.52), (-0.05, 0.62, 0.52)),
        _bar((*south, 0.30), (0.0, -1.0, 0.30)),
        # The first lidar hangs, so that cars can pass below it.
        _bar((*north, 0.315), (LIDAR_1[0], LIDAR_1[1], 0.315)),
        _bar((LIDAR_1[0], LIDAR_1[1], 0.32), (LIDAR_1[0], LIDAR_1[1], 0.30)),
        cylinder((0.0, -1.0, 0.29), (0.001, -0.9893, 0.40), 0.012, POLE, sides=10),
        _puck(LIDAR_1, above=True),
        _puck(LIDAR_2, above=False),
        _puck(LIDAR_3, above=False),
    ]
    for place, heading in NORTH_CAMERAS:
        hub = np.array([-0.05, 0.62, 0.52])
        end = np.array([place[0], place[1], 0.52])
        back = 0.03 * np.array([np.cos(np.deg2rad(heading)), np.sin(np.deg2rad(heading)), 0.0])
        parts += [
            _bar(hub, end - back),
            _bar(end - back, np.array(place) - back + [0, 0, 0.01]),
            _camera(place, heading),
        ]
    return parts + [_camera(place, heading) for place, heading in SOUTH_CAMERAS]


def _post(x: float, y: float, height: float) -> list[Mesh]:
    return [
        cylinder((x, y, 0.0), (x, y, height), 0.011, POLE, sides=12),
        cylinder((x, y, 0.0), (x, y, 0.008), 0.035, METAL, sides=16),
    ]


def _bar(start: npt.ArrayLike, end: npt.ArrayLike) -> Mesh:
    return cylinder(np.asarray(start), np.asarray(end), 0.0045, POLE, sides=8)


def _puck(place: tuple[float, float, float], *, above: bool) -> Mesh:
    """The housing of a lidar, outside its field of view of +-25 degrees."""
    near, far = (0.018, 0.045) if above else (-0.018, -0.045)
    x, y, z = place
    return cylinder((x, y, z + near), (x, y, z + far), 0.035, HOUSING, sides=18)


def _camera(place: tuple[float, float, float], heading_deg: float) -> Mesh:
    """The housing of a camera, behind its origin."""
    heading = np.deg2rad(heading_deg)
    back = np.array(place) - 0.030 * np.array([np.cos(heading), np.sin(heading), 0.0])
    return box(back, (0.034, 0.026, 0.024), DARK, yaw=float(heading))
