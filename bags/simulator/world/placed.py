"""Parts of movers at one time, for ray casting in single precision with one pose for all rays."""

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F32, F64, I64, U32, Bools

Floats = F32 | F64
Real = TypeVar("Real", np.float32, np.float64)

FEW_RAYS = 4096
"""Fewer rays are cast by a single thread: waking others costs more."""

_CORNERS = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T


@dataclass(frozen=True, slots=True, eq=False)
class PartHits:
    """The hits of N rays on a part.

    Attributes:
        rows: (K,) int64 rows of the rays that hit it, rising.
        distance: (K,) float32 metres.
        face: (N, 3) float32 normal of the triangle hit, in the part's frame.
        triangle: (N,) uint32 row of that triangle.
    """

    rows: I64
    distance: F32
    face: F32
    triangle: U32


class PartSurfaces(NamedTuple):
    """The surface of a part where K rays hit it.

    Attributes:
        normal: (K, 3) float32 unit vectors in the world, towards the side the ray comes from.
        material: (K,) int64 rows of the scene's palette.
        local: (K, 3) float32 metres, in the part's frame.
    """

    normal: F32
    material: I64
    local: F32


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
