"""Rays and what they hit, as parallel arrays."""

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F32, F64, I64, U32, Bools, Table, check_array

STATIC = -1
"""Mover row of the static world."""
NO_MATERIAL = -1
"""Material row of a miss."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays(Table):
    """Rays in the world frame."""

    origins: F64  # (N, 3) float64 metres
    directions: F64  # (N, 3) float64 unit vectors
    times_ns: I64  # (N,) int64 since the start of the scenario

    def __post_init__(self) -> None:
        n = len(self.times_ns)
        check_array("origins", self.origins, (n, 3), np.float64)
        check_array("directions", self.directions, (n, 3), np.float64)
        check_array("times_ns", self.times_ns, (n,), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Hits(Table):
    """The first surface along each of N rays."""

    distance_m: F64  # (N,) float64; infinite for a miss
    normal: F64  # (N, 3) float64 unit vectors in the world frame, towards the side the ray comes from; 0 for a miss
    material: I64  # (N,) int64 rows of `Scene.palette`, -1 for a miss
    mover: I64  # (N,) int64 rows of `Scene.movers`, `STATIC` for the static world and for a miss
    local: F64  # (N, 3) float64 metres: the point in the frame of the part (the world frame for the static world)

    def __post_init__(self) -> None:
        n = len(self.distance_m)
        check_array("distance_m", self.distance_m, (n,), np.float64)
        check_array("normal", self.normal, (n, 3), np.float64)
        check_array("material", self.material, (n,), np.int64)
        check_array("mover", self.mover, (n,), np.int64)
        check_array("local", self.local, (n, 3), np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The surfaces that N rays from one point hit."""

    origin: F64  # (3,) float64 origin of the rays in the world
    directions: F32  # (N, 3) float32 unit vectors in the world
    distance: F32  # (N,) float32 metres; infinite for a miss
    normal: F32  # (N, 3) float32 unit vectors in the world, towards the side the ray comes from; 0 for a miss
    material: I64  # (N,) int64 rows of the scene's palette, -1 for a miss
    local: F32 | F64  # (N, 3) metres, in the frame of the part (the world frame for the static world)

    def take(self, rows: I64) -> "Surfaces":
        """The surfaces of these rows."""
        return Surfaces(
            self.origin,
            self.directions.take(rows, 0),
            self.distance.take(rows),
            self.normal.take(rows, 0),
            self.material.take(rows),
            self.local.take(rows, 0),
        )

    @property
    def points(self) -> F32:
        """(N, 3) metres in the world, lifted off the surface so that rays from there do not hit it by rounding."""
        distance = np.where(np.isfinite(self.distance), self.distance, np.float32(0))
        lift = np.float32(5e-4) + np.float32(2e-5) * distance
        points = np.empty_like(self.directions)
        for axis, begin in enumerate(self.origin.astype(np.float32)):
            along = self.directions[:, axis] * distance
            along += lift * self.normal[:, axis]
            np.add(along, begin, out=points[:, axis])
        return points


# DOC Parts of movers at one time, for ray casting in single precision with one pose for all rays.


Floats = F32 | F64
Real = TypeVar("Real", np.float32, np.float64)

FEW_RAYS = 4096
"""Fewer rays are cast by a single thread: waking others costs more."""

_CORNERS = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T


@dataclass(frozen=True, slots=True, eq=False)
class PartHits:
    """The hits of N rays on a part."""

    rows: I64  # (K,) int64 rows of the rays that hit it, rising
    distance: F32  # (K,) float32 metres
    face: F32  # (N, 3) float32 normal of the triangle hit, in the part's frame
    triangle: U32  # (N,) uint32 row of that triangle


class PartSurfaces(NamedTuple):
    """The surface of a part where K rays hit it."""

    normal: F32  # (K, 3) float32 unit vectors in the world, towards the side the ray comes from
    material: I64  # (K,) int64 rows of the scene's palette
    local: F32  # (K, 3) float32 metres, in the part's frame


class PlacedPart:
    """One part at one time.

    Args:
        caster: Open3D ray caster with the part's mesh.
        tensor: Converts an array to an Open3D tensor.
        materials: (T,) palette row of each triangle.
        bounds: Lowest and highest x, y, z of the mesh.
        rotation: (3, 3) from the part's frame to the world.
        translation: (3,) metres, from the part's frame to the world.
    """

    def __init__(
        self, caster: Any, tensor: Any, materials: I64, bounds: tuple[F64, F64], rotation: F64, translation: F64
    ) -> None:
        self._caster, self._tensor, self._materials = caster, tensor, materials
        self._rotation, self._translation = rotation, translation
        low, high = bounds
        self.corners: F64 = (low + _CORNERS * (high - low)) @ rotation.T + translation
        self.center: F64 = (low + high) / 2 @ rotation.T + translation
        self.radius = float(np.linalg.norm(high - low)) / 2

    def cast(self, origin: F64, directions: F32) -> PartHits:
        """The hits of rays from one point (3,) along unit vectors (N, 3), all in the world."""
        rays = packed((origin - self._translation) @ self._rotation, mapped(directions, self._rotation.T))
        answer = self._caster.cast_rays(self._tensor(rays), nthreads=threads_for(len(rays)))
        distance = answer["t_hit"].numpy()
        rows = np.flatnonzero(np.isfinite(distance))
        face, triangle = answer["primitive_normals"].numpy(), answer["primitive_ids"].numpy()
        return PartHits(rows, distance.take(rows), face, triangle)

    def surfaces(self, hits: PartHits, some: I64, origin: F64, directions: F32) -> PartSurfaces:
        """The surfaces that some of the rays hit: rows (K,) of `hits.rows`, with directions (K, 3) in the world."""
        rays, distance = hits.rows.take(some), hits.distance.take(some)
        normal = mapped(hits.face.take(rays, 0), self._rotation)
        turn = np.where(dotted(normal, directions) > 0, np.float32(-1), np.float32(1))
        begin, ahead = (origin - self._translation) @ self._rotation, mapped(directions, self._rotation.T)
        local = np.empty_like(ahead)
        for axis in range(3):
            normal[:, axis] *= turn
            np.multiply(ahead[:, axis], distance, out=local[:, axis])
            local[:, axis] += np.float32(begin[axis])
        return PartSurfaces(normal, self._materials.take(hits.triangle.take(rays)), local)

    def occludes(self, points: F32, towards: F64) -> Bools:
        """Whether the part blocks light from a direction (3,) at points (N, 3) of the world."""
        shaded = np.zeros(len(points), np.bool_)
        near = passing_rays(points, towards, self.center, 1.001 * self.radius + 1e-4)
        if len(near):
            begins = mapped(points.take(near, 0), self._rotation.T, -self._translation @ self._rotation)
            rays = packed(begins, towards @ self._rotation)
            shaded[near] = self._caster.test_occlusions(self._tensor(rays), nthreads=threads_for(len(rays))).numpy()
        return shaded


def packed(origins: Floats, directions: Floats) -> F32:
    """Rays (N, 6) for the ray caster from origins and directions (N, 3); one of the two may be (3,) for all rays."""
    rays = np.empty((len(directions) if directions.ndim == 2 else len(origins), 6), np.float32)
    for axis in range(3):  # numpy is slow when the innermost axis is short
        rays[:, axis], rays[:, 3 + axis] = origins[..., axis], directions[..., axis]
    return rays


def threads_for(rays: int) -> int:
    """Number of threads for so many rays; 0 for one per processor."""
    return 1 if rays < FEW_RAYS else 0


def dotted(a: npt.NDArray[Real], b: npt.NDArray[Real]) -> npt.NDArray[Real]:
    """Dot products (N,) of vectors (N, 3) with vectors (N, 3), or with one (3,)."""
    products: npt.NDArray[Real] = a[:, 0] * b[..., 0]
    products += a[:, 1] * b[..., 1]
    products += a[:, 2] * b[..., 2]
    return products


def passing_rays(points: Floats, towards: F64, center: F64, radius: float) -> I64:
    """Rows of the points (N, 3) whose rays, in directions (N, 3) or one direction (3,), hit a sphere."""
    x, y, z = (middle - points[:, axis] for axis, middle in enumerate(center.tolist()))
    a, b, c = towards.astype(points.dtype, copy=False).T
    along = x * a + y * b + z * c
    across2 = x * x + y * y + z * z - along * along
    return np.flatnonzero((across2 <= radius * radius) & (along >= -radius))


def mapped(vectors: F32, matrix: F64, shift: F64 | None = None) -> F32:
    """Vectors (N, 3) times a matrix, plus a shift; with so few columns ten times as fast as numpy."""
    if not len(vectors):
        return np.empty((0, 3), np.float32)
    affine = matrix if shift is None else np.concatenate([matrix, shift[:, None]], 1)
    mapped = cv2.transform(vectors[:, None], affine.astype(np.float32)).reshape(-1, 3)
    return np.asarray(mapped, np.float32)
