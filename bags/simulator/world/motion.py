"""Poses as arrays, and paths that give them for any time."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Table, check_array
from lidcam.pipeline.core.geometry.transform import Transform

T_BODY_OPTICAL = Transform("body", "optical", np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]))
"""From a camera's optical axes (x right, y down, z forward) to those of its body (x forward, y left, z up); REP 103."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses(Table):
    """N rigid transforms from the frame of a thing to the world.

    Attributes:
        rotation: (N, 3, 3) float64.
        translation: (N, 3) float64 metres.
    """

    rotation: F64
    translation: F64

    def __post_init__(self) -> None:
        n = len(self.translation)
        check_array("rotation", self.rotation, (n, 3, 3), np.float64)
        check_array("translation", self.translation, (n, 3), np.float64)

    def __matmul__(self, other: "Poses") -> "Poses":
        """Composition, `other` first; a single pose on either side applies to all of the other."""
        return Poses(self.rotation @ other.rotation, self.apply(other.translation))

    def inverse(self) -> "Poses":
        """The inverse transforms."""
        rotation = self.rotation.transpose(0, 2, 1)
        return Poses(rotation, -turned(rotation, self.translation))

    def apply(self, points: F64) -> F64:
        """Points (N, 3) in the world, each transformed by its own pose, or all by a single one."""
        return turned(self.rotation, points) + self.translation


class Path(Protocol):
    """The pose of a thing at any simulated time."""

    def poses(self, times_ns: I64) -> Poses:
        """Poses (N) at times (N,) in nanoseconds since the start of the scenario."""


@dataclass(frozen=True, slots=True)
class FixedPath:
    """The path of a static thing."""

    T_world_thing: Transform

    def poses(self, times_ns: I64) -> Poses:
        """The same pose N times."""
        matrix = self.T_world_thing.matrix
        n = len(times_ns)
        return Poses(np.broadcast_to(matrix[:3, :3], (n, 3, 3)).copy(), np.broadcast_to(matrix[:3, 3], (n, 3)).copy())


@dataclass(frozen=True, slots=True)
class MountedPath:
    """The path of a thing with a fixed pose on a moving carrier."""

    carrier: Path
    T_carrier_thing: Transform

    def poses(self, times_ns: I64) -> Poses:
        """The carrier's poses times the fixed one."""
        matrix = self.T_carrier_thing.matrix
        return self.carrier.poses(times_ns) @ Poses(matrix[None, :3, :3], matrix[None, :3, 3])


def turned(rotation: F64, vectors: F64) -> F64:
    """Vectors (N, 3) times rotations (N, 3, 3); either may be a single one (1, ...) for all of the other."""
    if len(rotation) == 1:
        # Not BLAS: on a busy machine its threads wait for one another.
        x, y, z = vectors.T
        result = np.empty_like(vectors)
        for axis, (a, b, c) in enumerate(rotation[0]):
            result[:, axis] = a * x + b * y + c * z
        return result
    if len(vectors) == 1:
        return np.asarray(np.einsum("nij,j->ni", rotation, vectors[0]))
    return np.asarray(np.einsum("nij,nj->ni", rotation, vectors))


def upright_poses(positions: F64, yaws: F64) -> Poses:
    """Poses of upright things at positions (N, 3), metres, turned by yaws (N,), radians about +z."""
    cos, sin, zero, one = np.cos(yaws), np.sin(yaws), np.zeros_like(yaws), np.ones_like(yaws)
    rotation = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], -1).reshape(-1, 3, 3)
    return Poses(rotation, np.asarray(positions, np.float64))
