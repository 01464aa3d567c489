"""Triangle meshes with materials, and the simple bodies that everything is built of.

Lengths are metres in the frame of the thing that a body belongs to (x forward, y left, z up; REP 103). Triangles run
counter-clockwise seen from outside.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64, I64, check_array

Rgb = tuple[float, float, float]
Texture = Literal[
    "plain",
    "asphalt",
    "bark",
    "brick",
    "concrete",
    "crossing",
    "facade",
    "foliage",
    "glass_front",
    "grass",
    "model_front",
    "paving",
    "roof",
    "sandbox",
    "street",
    "wood",
]


@dataclass(frozen=True, slots=True)
class Material:
    """The appearance of a surface to a camera and to a lidar.

    Attributes:
        name: A label for people.
        rgb: Diffuse sRGB colour, each in [0, 1].
        reflectivity: Share of a 905 nm beam that is reflected, 1 for a white surface; above 1 for a retroreflector
            (number plate, sign, tail lamp).
        mirror: Share of light reflected specularly at normal incidence (Schlick's F0); 0 is matt.
        transmission: Share of a lidar beam that passes through (glass).
        texture: Pattern that varies the colour over the surface.
    """

    name: str
    rgb: Rgb
    reflectivity: float = 0.3
    mirror: float = 0.0
    transmission: float = 0.0
    texture: Texture = "plain"


@dataclass(frozen=True, slots=True)
class Look:
    """One of a texture's colours.

    Attributes:
        rgb: sRGB colour; None for the material's own.
        reflectivity: As in `Material`; None for the material's own.
    """

    rgb: Rgb | None = None
    reflectivity: float | None = None


OWN = Look()
"""The look of the material itself."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: (V, 3) float64 metres.
        triangles: (T, 3) int64 rows of `vertices`.
        materials: (T,) int64 rows of `palette`.
        palette: Materials in use.
    """

    vertices: F64
    triangles: I64
    materials: I64
    palette: tuple[Material, ...]

    def __post_init__(self) -> None:
        check_array("vertices", self.vertices, (len(self.vertices), 3), np.float64)
        n = len(self.triangles)
        check_array("triangles", self.triangles, (n, 3), np.int64)
        check_array("materials", self.materials, (n,), np.int64)

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
    start: npt.ArrayLike,
    end: npt.ArrayLike,
    radius: float,
    material: Material,
    *,
    sides: int = 16,
    taper: float = 1.0,
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
    body = np.stack(
        [
            np.outer(np.sin(tilt), np.cos(turn)),
            np.outer(np.sin(tilt), np.sin(turn)),
            np.repeat(np.cos(tilt)[:, None], sides, 1),
        ],
        -1,
    ).reshape(-1, 3)
    vertices = np.concatenate([body, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]) * radius + np.asarray(center, np.float64)
    here = np.arange(sides)
    after = (here + 1) % sides
    north, south, last = len(body), len(body) + 1, (rings - 2) * sides
    faces = [
        np.stack([np.full(sides, north), here, after], 1),
        np.stack([np.full(sides, south), last + after, last + here], 1),
    ]
    for ring in range(rings - 2):
        upper, lower = ring * sides, (ring + 1) * sides
        faces.append(np.stack([upper + here, lower + here, lower + after], 1))
        faces.append(np.stack([upper + here, lower + after, upper + after], 1))
    triangles = np.concatenate(faces).astype(np.int64)
    return Mesh(vertices, triangles, np.zeros(len(triangles), np.int64), (material,))


def polygon(corners: npt.ArrayLike, material: Material) -> Mesh:
    """A flat convex face (K, 3), counter-clockwise seen from its visible side."""
    vertices = np.asarray(corners, np.float64)
    k = len(vertices)
    triangles = np.stack([np.zeros(k - 2, np.int64), np.arange(1, k - 1), np.arange(2, k)], 1)
    return Mesh(vertices, triangles, np.zeros(k - 2, np.int64), (material,))


def ring_faces(rings: int, k: int) -> I64:
    """Triangles of a closed body over rings of K vertices each: first end, last end, then the sides ring by ring."""
    here = np.arange(k)
    after = (here + 1) % k
    fan = np.stack([np.zeros(k - 2, np.int64), np.arange(1, k - 1), np.arange(2, k)], 1)
    faces = [fan[:, ::-1], fan + (rings - 1) * k]
    for low in range(0, (rings - 1) * k, k):
        sides = [here + low, after + low, after + low + k], [here + low, after + low + k, here + low + k]
        faces += [np.stack(side, 1) for side in sides]
    return np.concatenate(faces).astype(np.int64)
