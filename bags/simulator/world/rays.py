"""Rays and what they hit, as parallel arrays."""

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F32, F64, I64, U32, Table

Floats = F32 | F64
Real = TypeVar("Real", np.float32, np.float64)

STATIC = -1  # mover row of the static world
NO_MATERIAL = -1  # material row of a miss
MIN_PARALLEL_RAYS = 4096  # fewer rays are cast by a single thread: waking others costs more


@dataclass(frozen=True, slots=True, eq=False)
class Rays(Table):
    """Rays in the world frame."""

    origins: F64  # (N, 3) metres
    directions: F64  # (N, 3) unit vectors
    times_ns: I64  # (N,) since the start of the scenario


@dataclass(frozen=True, slots=True, eq=False)
class Hits(Table):
    """The first surface along each of N rays."""

    distance_m: F64  # (N,); infinite for a miss
    normal: F64  # (N, 3) unit vectors in the world, towards the side the ray comes from; 0 for a miss
    material: I64  # (N,) rows of `Scene.palette`, `NO_MATERIAL` for a miss
    mover: I64  # (N,) rows of `Scene.movers`, `STATIC` for the static world and for a miss
    local: F64  # (N, 3) the point in the frame of the part (the world frame for the static world), metres


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The surfaces that N rays from one point hit."""

    origin: F64  # (3,) of the rays in the world
    directions: F32  # (N, 3) unit vectors in the world
    distance: F32  # (N,) metres; the rest as in `Hits`
    normal: F32
    material: I64
    local: F32 | F64

    def take(self, rows: I64) -> "Surfaces":
        """The surfaces of these rows."""
        columns: tuple[Any, ...] = self.directions, self.distance, self.normal, self.material, self.local
        return Surfaces(self.origin, *(column.take(rows, 0) for column in columns))

    @property
    def points(self) -> F32:
        """(N, 3) metres in the world, lifted off the surface so that rays from there do not hit it by rounding."""
        distance = np.where(np.isfinite(self.distance), self.distance, np.float32(0))
        lift = np.float32(5e-4) + np.float32(2e-5) * distance
        lifted = self.directions * distance[:, None] + lift[:, None] * self.normal
        return np.asarray(lifted + self.origin.astype(np.float32), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class PartHits:
    """The hits of N rays on a part."""

    rows: I64  # (K,) rows of the rays that hit it, rising
    distance: F32  # (K,) metres
    face: F32  # (N, 3) normal of the triangle hit, in the part's frame
    triangle: U32  # (N,) row of that triangle


class PartSurfaces(NamedTuple):
    """The surface of a part where K rays hit it."""

    normal: F32  # (K, 3); see `Hits`
    material: I64
    local: F32


def packed(origins: Floats, directions: Floats) -> F32:
    """Rays (N, 6) for the ray caster from origins and directions (N, 3); one of the two may be (3,) for all rays."""
    rays = np.empty((len(directions) if directions.ndim == 2 else len(origins), 6), np.float32)
    rays[:, :3], rays[:, 3:] = origins, directions
    return rays


def threads_for(rays: int) -> int:
    """Number of threads for a number of rays; 0 for one per processor."""
    return 1 if rays < MIN_PARALLEL_RAYS else 0


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
