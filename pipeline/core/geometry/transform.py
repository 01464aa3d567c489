"""Rigid transforms between named frames.

`T_dst_src` maps points of frame `src` to frame `dst`; chains read `T_site_base @ T_base_lidar`. Frames follow REP 103
(x forward, y left, z up; camera optical frames z forward, x right, y down).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64, Array, check_array
from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.rotations import matrix_of_quaternion, pose_matrix, quaternion_of_matrix

ROTATION_TOLERANCE = 1e-3
"""Largest entry of R R^T - I accepted as rounding: calibration files often carry three or four digits."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """A rigid motion from one named frame to another."""

    dst: str  # Frame of the output points
    src: str  # Frame of the input points
    matrix: F64  # (4, 4) float64, homogeneous; read-only

    def __post_init__(self) -> None:
        check_array("matrix", self.matrix, (4, 4), np.float64)

    def __matmul__(self, other: "Transform") -> "Transform":
        """T_dst_other_src, the composition of two transforms; raises FrameError if the inner frames differ."""
        if self.src != other.dst:
            raise FrameError(f"cannot chain {self.dst}<-{self.src} with {other.dst}<-{other.src}: inner frames differ")
        return Transform(self.dst, other.src, self.matrix @ other.matrix)

    def inverse(self) -> "Transform":
        """T_src_dst."""
        rotation = self.matrix[:3, :3].T
        return Transform(self.src, self.dst, pose_matrix(rotation, -rotation @ self.matrix[:3, 3]))

    def apply(self, points: Array) -> Array:
        """Points (..., 3) of `src` in `dst`; the dtype is kept."""
        # Not BLAS: for products this thin its threads cost tens of milliseconds of waiting on a busy machine.
        x, y, z = np.moveaxis(points, -1, 0)
        moved = np.empty_like(points)
        for axis, (a, b, c, shift) in enumerate(self.matrix[:3].astype(points.dtype)):
            moved[..., axis] = a * x + b * y + c * z + shift
        return moved

    @property
    def translation(self) -> F64:
        """(3,) origin of `src` seen in `dst`, metres."""
        return self.matrix[:3, 3]

    @property
    def quaternion_xyzw(self) -> F64:
        """(4,) unit quaternion x, y, z, w with w >= 0."""
        return quaternion_of_matrix(self.matrix[:3, :3])

    @classmethod
    def identity(cls, dst: str, src: str) -> "Transform":
        """The transform between two names of one frame."""
        return cls(dst, src, np.eye(4))

    @classmethod
    def from_quaternion(cls, dst: str, src: str, translation: npt.ArrayLike, xyzw: npt.ArrayLike) -> "Transform":
        """From a translation (3,) in metres and a quaternion x, y, z, w of any positive length.

        Raises:
            FrameError: the quaternion has zero length, or a number is not finite.
        """
        quaternion, shift = np.asarray(xyzw, np.float64), np.asarray(translation, np.float64)
        norm = float(np.linalg.norm(quaternion))
        if not (np.isfinite(norm) and norm > 1e-6 and np.isfinite(shift).all()):
            raise FrameError(
                f"transform {dst}<-{src}: expected a unit quaternion and finite metres, "
                f"got {quaternion.tolist()} and {shift.tolist()}"
            )
        return cls(dst, src, pose_matrix(matrix_of_quaternion(quaternion), shift))


def rotation_fault(rotation: F64) -> str | None:
    """Why a (3, 3) matrix is not a rotation, for an error message; None if it is one."""
    if not np.isfinite(rotation).all():
        return "it contains numbers that are not finite"
    with np.errstate(over="ignore", invalid="ignore"):
        determinant = float(np.linalg.det(rotation))
        deviation = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if abs(determinant) < 1e-9:
        return "it is singular (determinant 0)"
    if not deviation <= ROTATION_TOLERANCE:
        return f"its rows are not orthonormal (off by {deviation:.3g})"
    if determinant < 0:
        return "it is a reflection (determinant -1): one axis is flipped"
    return None
