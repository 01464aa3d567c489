"""Triangle meshes with materials, and the simple bodies that everything is built of.

Lengths are metres in the frame of the thing that a body belongs to (x forward, y left, z up; REP 103). Triangles run
counter-clockwise seen from outside.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64, I64

Rgb = tuple[float, float, float]
Texture = Literal[
    "plain", "asphalt", "bark", "brick", "concrete", "crossing", "facade", "foliage", "glass_front", "grass",
    "model_front", "paving", "roof", "sandbox", "street", "wood",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Material:
    """The appearance of a surface to a camera and to a lidar."""

    name: str  # a label for people
    rgb: Rgb  # diffuse sRGB colour, each in [0, 1]
    # Share of a 905 nm beam that is reflected, 1 for a white surface; above 1 for a retroreflector (number plate, sign,
    # tail lamp)
    reflectivity: float = 0.3
    mirror: float = 0.0  # share of light reflected specularly at normal incidence (Schlick's F0); 0 is matt
    transmission: float = 0.0  # share of a lidar beam that passes through (glass)
    texture: Texture = "plain"  # pattern that varies the colour over the surface


@dataclass(frozen=True, slots=True)
class Look:
    """One of a texture's colours."""

    rgb: Rgb | None = None  # sRGB colour; None for the material's own
    reflectivity: float | None = None  # as in `Material`; None for the material's own


RUBBER = Material("rubber", (0.16, 0.16, 0.165), 0.06)
DARK = Material("dark plastic", (0.13, 0.13, 0.14), 0.08, mirror=0.02)
SEAM = Material("seam", (0.10, 0.10, 0.11), 0.10)
GLASS = Material("glass", (0.13, 0.16, 0.18), 0.06, mirror=0.10, transmission=0.6)
CHROME = Material("chrome", (0.62, 0.63, 0.65), 0.5, mirror=0.35)
METAL = Material("steel", (0.45, 0.46, 0.48), 0.4, mirror=0.06)
HEADLAMP = Material("headlamp", (0.90, 0.92, 0.93), 0.9, mirror=0.15)
TAIL_LAMP = Material("tail lamp", (0.70, 0.05, 0.05), 1.6, mirror=0.05)
SIGNAL = Material("direction lamp", (0.95, 0.50, 0.08), 1.2, mirror=0.05)
PLATE = Material("number plate", (0.93, 0.93, 0.90), 3.0)
PLATE_YELLOW = Material("number plate, rear", (0.93, 0.86, 0.55), 3.0)

OWN = Look()  # the look of the material itself


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh."""

    vertices: F64  # (V, 3) float64 metres
    triangles: I64  # (T, 3) int64 rows of `vertices`
    materials: I64  # (T,) int64 rows of `palette`
    palette: tuple[Material, ...]  # materials in use

    def __len__(self) -> int:
        return len(self.triangles)

    def moved(self, translation: npt.ArrayLike = (0.0, 0.0, 0.0), *, yaw: float = 0.0, scale: float = 1.0) -> "Mesh":
        """The mesh scaled about the origin, rotated about +z, then translated."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        vertices = scale * self.vertices @ turn.T + np.asarray(translation, np.float64)
        return Mesh(vertices, self.triangles, self.materials, self.palette)

    def recolored(self, looks: Mapping[Material, Material]) -> "Mesh":
        """The mesh with some of its materials replaced by others."""
        palette = tuple(looks.get(material, material) for material in self.palette)
        return Mesh(self.vertices, self.triangles, self.materials, palette)

    @property
    def bounds(self) -> tuple[F64, F64]:
        """Lowest and highest x, y, z."""
        return self.vertices.min(0), self.vertices.max(0)


def merged(*parts: Mesh) -> Mesh:
    """All parts as one mesh; each material is in its palette once."""
    palette = tuple(dict.fromkeys(material for part in parts for material in part.palette))
    row = {material: index for index, material in enumerate(palette)}
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    triangles = [part.triangles + start for part, start in zip(parts, starts[:-1], strict=True)]
    rows = [np.array([row[material] for material in part.palette], np.int64)[part.materials] for part in parts]
    return Mesh(
        np.concatenate([np.empty((0, 3)), *(part.vertices for part in parts)]),
        np.concatenate([np.empty((0, 3), np.int64), *triangles]),
        np.concatenate([np.empty(0, np.int64), *rows]),
        palette,
    )


def box(center: npt.ArrayLike, size: Sequence[float], material: Material, *, yaw: float = 0.0) -> Mesh:
    """An upright box."""
    length, width, _ = size
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (length / 2, width / 2)
    return prism(corners, -size[2] / 2, size[2] / 2, material).moved(center, yaw=yaw)


def prism(outline: npt.ArrayLike, bottom: float, top: float, material: Material) -> Mesh:
    """An upright prism over a convex outline (K, 2), counter-clockwise from above, between two heights."""
    xy = np.asarray(outline, np.float64)
    k = len(xy)
    vertices = np.concatenate([np.c_[xy, np.full(k, bottom)], np.c_[xy, np.full(k, top)]])
    return Mesh(vertices, ring_faces(2, k), np.zeros(4 * k - 4, np.int64), (material,))


def cylinder(
    start: npt.ArrayLike, end: npt.ArrayLike, radius: float, material: Material, *, sides: int = 16, taper: float = 1.0
) -> Mesh:
    """A round bar from `start` to `end`, where its radius is `taper` times that at the start."""
    first, last = np.asarray(start, np.float64), np.asarray(end, np.float64)
    axis = (last - first) / np.linalg.norm(last - first)
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(axis, side))
    vertices = np.concatenate([first + ring, last + taper * ring])
    return Mesh(vertices, ring_faces(2, sides), np.zeros(4 * sides - 4, np.int64), (material,))


def sphere(center: npt.ArrayLike, radius: float, material: Material, *, sides: int = 12) -> Mesh:
    """A sphere of `sides` meridians and half as many rings."""
    rings = sides // 2
    tilt = np.pi * np.arange(1, rings) / rings
    turn = 2 * np.pi * np.arange(sides) / sides
    x, y = np.outer(np.sin(tilt), np.cos(turn)), np.outer(np.sin(tilt), np.sin(turn))
    body = np.stack([x, y, np.repeat(np.cos(tilt)[:, None], sides, 1)], -1).reshape(-1, 3)
    vertices = np.concatenate([body, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]) * radius + np.asarray(center, np.float64)
    here = np.arange(sides)
    after = (here + 1) % sides
    north, south, last = np.full(sides, len(body)), np.full(sides, len(body) + 1), (rings - 2) * sides
    caps = np.stack([north, here, after], 1), np.stack([south, last + after, last + here], 1)
    bands = ring_faces(rings - 1, sides)[2 * (sides - 2) :, [0, 2, 1]]
    triangles = np.concatenate([*caps, bands])
    return Mesh(vertices, triangles, np.zeros(len(triangles), np.int64), (material,))


def polygon(corners: npt.ArrayLike, material: Material) -> Mesh:
    """A flat convex face (K, 3), counter-clockwise seen from its visible side."""
    vertices = np.asarray(corners, np.float64)
    k = len(vertices)
    return Mesh(vertices, _fan(k), np.zeros(k - 2, np.int64), (material,))


def _fan(k: int) -> I64:
    return np.stack([np.zeros(k - 2, np.int64), np.arange(1, k - 1), np.arange(2, k)], 1)


def ring_faces(rings: int, k: int) -> I64:
    """Triangles of a closed body over rings of K vertices each: first end, last end, then the sides ring by ring."""
    here = np.arange(k)
    after = (here + 1) % k
    faces = [_fan(k)[:, ::-1], _fan(k) + (rings - 1) * k]
    for low in range(0, (rings - 1) * k, k):
        sides = [here + low, after + low, after + low + k], [here + low, after + low + k, here + low + k]
        faces += [np.stack(side, 1) for side in sides]
    return np.concatenate(faces).astype(np.int64)


def paint(color: Rgb) -> Material:
    """Car paint; dark paint reflects less of a lidar's light."""
    brightness = 0.3 * color[0] + 0.59 * color[1] + 0.11 * color[2]
    return Material("paint", color, 0.10 + 0.75 * brightness**1.5, mirror=0.05)


def loft(
    rings: npt.ArrayLike,
    material: Material,
    *,
    where: Callable[[int, int], Material] | None = None,
    ends: tuple[Material, Material] | None = None,
) -> Mesh:
    """A loft through rings of points (R, K, 3), closed by a fan at each convex end.

    `where` gives the material of a face, from the index of its first ring and of its first point; `ends` those of the
    fans.
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
    spans = zip(pairwise(path), pairwise(radii), strict=True)
    return merged(*(cylinder(a, b, r, material, sides=sides, taper=end / r) for (a, b), (r, end) in spans))


def torus(
    center: Sequence[float], radius: float, thickness: float, material: Material, *, sides: int = 24, around: int = 6
) -> Mesh:
    """A torus about the y axis; `radius` is the outer one, `thickness` that of the tube."""
    turn = 2 * np.pi * np.arange(sides) / sides - np.pi / 2
    bend = 2 * np.pi * np.arange(around) / around
    reach = radius - thickness / 2 + thickness / 2 * np.cos(bend)
    x, z, y = np.outer(np.cos(turn), reach), np.outer(np.sin(turn), reach), thickness / 2 * np.sin(bend)
    points = np.stack([x, np.broadcast_to(y, x.shape), z], -1).reshape(-1, 3) + np.asarray(center, np.float64)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(sides), np.arange(around), indexing="ij"))
    a, b = i * around + j, (i + 1) % sides * around + j
    c, d = (i + 1) % sides * around + (j + 1) % around, i * around + (j + 1) % around
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int64)
    return _outward(points, faces, [material] * len(faces))


def panel(corners: npt.ArrayLike, material: Material, *, thickness: float = 0.008) -> Mesh:
    """A thin plate on a face, sunk into it by half its thickness (metres); `corners` (K, 3) are its convex outline."""
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
