"""Rays and what they hit, as parallel arrays."""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Table, check_array

STATIC = -1
"""Mover row of the static world."""
NO_MATERIAL = -1
"""Material row of a miss."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays(Table):
    """Rays in the world frame.

    Attributes:
        origins: (N, 3) float64 metres.
        directions: (N, 3) float64 unit vectors.
        times_ns: (N,) int64 since the start of the scenario.
    """

    origins: F64
    directions: F64
    times_ns: I64

    def __post_init__(self) -> None:
        n = len(self.times_ns)
        check_array("origins", self.origins, (n, 3), np.float64)
        check_array("directions", self.directions, (n, 3), np.float64)
        check_array("times_ns", self.times_ns, (n,), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Hits(Table):
    """The first surface along each of N rays.

    Attributes:
        distance_m: (N,) float64; infinite for a miss.
        normal: (N, 3) float64 unit vectors in the world frame, towards the side the ray comes from; 0 for a miss.
        material: (N,) int64 rows of `Scene.palette`, -1 for a miss.
        mover: (N,) int64 rows of `Scene.movers`, `STATIC` for the static world and for a miss.
        local: (N, 3) float64 metres: the point in the frame of the part (the world frame for the static world).
    """

    distance_m: F64
    normal: F64
    material: I64
    mover: I64
    local: F64

    def __post_init__(self) -> None:
        n = len(self.distance_m)
        check_array("distance_m", self.distance_m, (n,), np.float64)
        check_array("normal", self.normal, (n, 3), np.float64)
        check_array("material", self.material, (n,), np.int64)
        check_array("mover", self.mover, (n,), np.int64)
        check_array("local", self.local, (n, 3), np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The surfaces that N rays from one point hit.

    Attributes:
        origin: (3,) float64 origin of the rays in the world.
        directions: (N, 3) float32 unit vectors in the world.
        distance: (N,) float32 metres; infinite for a miss.
        normal: (N, 3) float32 unit vectors in the world, towards the side the ray comes from; 0 for a miss.
        material: (N,) int64 rows of the scene's palette, -1 for a miss.
        local: (N, 3) metres, in the frame of the part (the world frame for the static world).
    """

    origin: F64
    directions: F32
    distance: F32
    normal: F32
    material: I64
    local: F32 | F64

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
