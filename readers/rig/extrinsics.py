"""Matrices that people or calibration tools wrote, checked and turned into transforms."""

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.transform import Transform, rotation_fault

MAX_ROUNDING = 1e-6
"""Largest deviation of an exact matrix; a rotation with a larger one was rounded and becomes the nearest rotation."""


def rigid_transform(name: str, dst: str, src: str, values: npt.ArrayLike) -> Transform:
    """T_dst_src from sixteen numbers.

    A rotation that was rounded to a few digits becomes the nearest rotation (polar decomposition), because `inverse`
    transposes it.

    Raises:
        CalibrationError: the matrix is not rigid; says what is wrong with `name`.
    """
    matrix = np.array(values, np.float64).reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise CalibrationError(f"{name} holds numbers that are not finite")
    if fault := rotation_fault(matrix[:3, :3]):
        raise CalibrationError(f"the rotation of {name} is not valid: {fault}")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > MAX_ROUNDING:
        raise CalibrationError(f"the last row of {name} is {matrix[3].tolist()}: expected 0 0 0 1")
    if dst == src and np.abs(matrix - np.eye(4)).max() > MAX_ROUNDING:
        raise CalibrationError(f"{name} moves frame {dst!r} against itself: give the sensor or the site another frame")
    matrix[3] = [0, 0, 0, 1]
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > MAX_ROUNDING:
        u, _, vt = np.linalg.svd(rotation)
        matrix[:3, :3] = u @ vt
    return Transform(dst, src, matrix)


def decompose_projection(name: str, values: npt.ArrayLike) -> tuple[F64, F64]:
    """K (3, 3) with K[2, 2] = 1 and T_camera_site (4, 4) of a projection P = s K [R | t], depth positive in front.

    By RQ decomposition (Hartley and Zisserman, Multiple View Geometry, 6.2.4).

    Raises:
        CalibrationError: P[:, :3] is singular or mirrored.
    """
    P = np.array(values, np.float64).reshape(3, 4)
    if not np.isfinite(P).all():
        raise CalibrationError(f"{name} holds numbers that are not finite")
    scale = float(np.linalg.norm(P[2, :3]))
    if scale < 1e-12 or abs(np.linalg.det(P[:, :3] / np.abs(P[:, :3]).max())) < 1e-12:
        raise CalibrationError(f"{name} is singular: its left 3 x 3 part has determinant 0, so it projects nothing")
    P = P / scale
    if np.linalg.det(P[:, :3]) < 0:
        raise CalibrationError(f"{name} is mirrored (negative determinant): expected depth that is positive in front")
    from scipy.linalg import rq  # a fifth of a second, for cameras whose pose is in P alone

    K, R = rq(P[:, :3])
    signs = np.where(np.diag(K) < 0, -1.0, 1.0)
    K, R = K * signs, signs[:, None] * R
    matrix = np.eye(4)
    matrix[:3, :3] = R
    matrix[:3, 3] = np.linalg.solve(K, P[:, 3])
    return np.asarray(K / K[2, 2], np.float64), matrix
