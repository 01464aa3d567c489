"""Closed bodies beyond boxes and cylinders: lofts, tori, wheels, panels.

Triangles run counter-clockwise seen from outside, as in `lidcam.bags.simulator.world.meshes.mesh`.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from lidcam.bags.simulator.world.meshes.mesh import Material, Mesh, cylinder, merged, ring_faces
from lidcam.pipeline.core.arrays import F64, I64


def loft(
    rings: npt.ArrayLike,
    material: Material,
    *,
    where: Callable[[int, int], Material] | None = None,
    ends: tuple[Material, Material] | None = None,
) -> Mesh:
    """A loft through rings of equally many points, closed by a fan at each end.

    Args:
        rings: (R, K, 3) points, R >= 2; the end rings are convex.
        material: Material of all faces that `where` and `ends` leave open.
        where: Material of a face, from the index of its first ring and of its first point.
        ends: Materials of the fans at the first and the last ring.
    """
    points = np.asarray(rings, np.float64)
    r, k = points.shape[:2]
    first, last = ends or (material, material)
    looks = [first] * (k - 2) + [last] * (k - 2)
    for ring in range(r - 1):
        looks += 2 * [where(ring, side) if where else material for side in range(k)]
    return _outward(points.reshape(-1, 3), ring_faces(r, k), looks)


def ellipses(rows: Sequence[tuple[float, float, float, float, float]], material: Material, *, sides: int = 10) -> Mesh:
    """An upright loft through ellipses given as z, centre x, centre y, half length, half width."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    rings = [np.stack([x + a * np.cos(angle), y + b * np.sin(angle), np.full(sides, z)], 1) for z, x, y, a, b in rows]
    return loft(np.stack(rings), material)


def limb(points: npt.ArrayLike, radii: Sequence[float], material: Material, *, sides: int = 8) -> Mesh:
    """Round bars from point to point (K, 3), with a radius at each point."""
    path = np.asarray(points, np.float64)
    bars = [
        cylinder(path[i], path[i + 1], radii[i], material, sides=sides, taper=radii[i + 1] / radii[i])
        for i in range(len(path) - 1)
    ]
    return merged(*bars)


def torus(
    center: Sequence[float], radius: float, thickness: float, material: Material, *, sides: int = 24, around: int = 6
) -> Mesh:
    """A torus about the y axis; `radius` is the outer one, `thickness` that of the tube."""
    turn = 2 * np.pi * np.arange(sides) / sides - np.pi / 2
    bend = 2 * np.pi * np.arange(around) / around
    reach = radius - thickness / 2 + thickness / 2 * np.cos(bend)
    points = np.stack(
        [
            np.cos(turn)[:, None] * reach,
            np.broadcast_to(thickness / 2 * np.sin(bend), (sides, around)),
            np.sin(turn)[:, None] * reach,
        ],
        -1,
    ).reshape(-1, 3) + np.asarray(center, np.float64)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(sides), np.arange(around), indexing="ij"))
    a, b = i * around + j, (i + 1) % sides * around + j
    c, d = (i + 1) % sides * around + (j + 1) % around, i * around + (j + 1) % around
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int64)
    return _outward(points, faces, [material] * len(faces))


def wheel(radius: float, width: float, tyre: Material, rim: Material, hub: Material, *, sides: int = 20) -> Mesh:
    """A wheel about the y axis with its centre at the origin; a vertex is its lowest point."""
    half = width / 2
    profile = [
        (0.22, -half * 0.85),
        (0.60, -half * 0.75),
        (0.66, -half * 0.98),
        (0.94, -half),
        (1.0, -half * 0.74),
        (1.0, half * 0.74),
        (0.94, half),
        (0.66, half * 0.98),
        (0.60, half * 0.75),
        (0.22, half * 0.85),
    ]
    turn = 2 * np.pi * np.arange(sides) / sides - np.pi / 2
    rings = [
        np.stack([share * radius * np.cos(turn), np.full(sides, y), share * radius * np.sin(turn)], 1)
        for share, y in profile
    ]
    looks = [rim, rim, tyre, tyre, tyre, tyre, tyre, rim, rim]
    return loft(np.stack(rings), tyre, where=lambda ring, _: looks[ring], ends=(hub, hub))


def panel(corners: npt.ArrayLike, material: Material, *, thickness: float = 0.008) -> Mesh:
    """A thin plate on a face, sunk into it by half its thickness (metres).

    Its corners (K, 3) are a convex outline on the face, counter-clockwise seen from outside.
    """
    face = np.asarray(corners, np.float64)
    normal = np.cross(face[1] - face[0], face[2] - face[0])
    normal *= thickness / 2 / np.linalg.norm(normal)
    return loft(np.stack([face - normal, face + normal]), material)


def _outward(points: F64, faces: I64, looks: Sequence[Material]) -> Mesh:
    """The mesh, with its triangles flipped if its volume is negative."""
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    if float((a * np.cross(b, c)).sum()) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    palette = tuple(dict.fromkeys(looks))
    row = {look: index for index, look in enumerate(palette)}
    return Mesh(points, faces, np.array([row[look] for look in looks], np.int64), palette)
