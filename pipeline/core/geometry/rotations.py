"""Rotations as matrices, unit quaternions, angles and rotation vectors.

A few formulas, in the order of operations of `scipy.spatial.transform.Rotation`, so that both give the same numbers:
importing that costs every start of the program a third of a second. Sines are those of the C library: those of numpy's
vector instructions differ in the last digit between machines.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64

MIN_ANGLE_RAD = 1e-9


def matrix_of_quaternion(xyzw: npt.ArrayLike) -> F64:
    """Rotation matrices (..., 3, 3) of quaternions x, y, z, w (..., 4) of any positive length."""
    x, y, z, w = np.moveaxis(np.asarray(xyzw, np.float64), -1, 0)
    length = np.sqrt(x * x + y * y + z * z + w * w)
    return _matrix(x / length, y / length, z / length, w / length)


def _matrix(x: F64 | np.float64, y: F64 | np.float64, z: F64 | np.float64, w: F64 | np.float64) -> F64:
    """Rotation matrices (..., 3, 3) of the parts of unit quaternions, each (...)."""
    x2, y2, z2, w2 = x * x, y * y, z * z, w * w
    xy, zw, xz, yw, yz, xw = x * y, z * w, x * z, y * w, y * z, x * w
    matrix = np.empty((*np.shape(x), 3, 3))
    matrix[..., 0, 0] = x2 - y2 - z2 + w2
    matrix[..., 1, 0] = 2 * (xy + zw)
    matrix[..., 2, 0] = 2 * (xz - yw)
    matrix[..., 0, 1] = 2 * (xy - zw)
    matrix[..., 1, 1] = -x2 + y2 - z2 + w2
    matrix[..., 2, 1] = 2 * (yz + xw)
    matrix[..., 0, 2] = 2 * (xz + yw)
    matrix[..., 1, 2] = 2 * (yz - xw)
    matrix[..., 2, 2] = -x2 - y2 + z2 + w2
    return matrix


def matrix_of_rpy(rpy_rad: Sequence[float] | F64) -> F64:
    """Rotation matrix (3, 3) of roll about x, then pitch about y, then yaw about z of the fixed frame (REP 103)."""
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(angle / 2), math.cos(angle / 2)) for angle in map(float, rpy_rad))
    x, y, z, w = cy * sx, sy * cx, -sy * sx, cy * cx
    return _matrix(*map(np.float64, (cz * x - sz * y, cz * y + sz * x, cz * z + w * sz, cz * w - sz * z)))


def quaternion_of_matrix(matrix: F64) -> F64:
    """(4,) unit quaternion x, y, z, w with w >= 0 of the rotation nearest to a matrix (3, 3).

    Source: F. Landis Markley, Unit quaternion from rotation matrix, Journal of Guidance, Control, and Dynamics 31(2),
    2008.

    Raises:
        ValueError: the matrix is singular or flips an axis.
    """
    if not np.linalg.det(matrix) > 0:
        raise ValueError(f"expected a rotation, found {matrix.tolist()}")
    if not np.isclose(matrix @ matrix.T, np.eye(3), atol=1e-12).all():
        left, _, right = np.linalg.svd(matrix)
        matrix = left @ right
    m: list[list[float]] = matrix.tolist()
    trace = m[0][0] + m[1][1] + m[2][2]
    largest = max(range(4), key=[m[0][0], m[1][1], m[2][2], trace].__getitem__)
    if largest == 3:
        xyzw = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1 + trace]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        xyzw = [0.0, 0.0, 0.0, m[k][j] - m[j][k]]
        xyzw[i] = 1 - trace + 2 * m[i][i]
        xyzw[j] = m[j][i] + m[i][j]
        xyzw[k] = m[k][i] + m[i][k]
    x, y, z, w = xyzw
    length = math.sqrt(x * x + y * y + z * z + w * w)
    sign = -1.0 if (w, x, y, z) < (0, 0, 0, 0) else 1.0
    return np.array([sign * (value / length) for value in xyzw])


def pose_matrix(rotation: npt.ArrayLike, translation: npt.ArrayLike = 0.0) -> F64:
    """(..., 4, 4) poses of rotations (..., 3, 3) and translations (..., 3), without which they are none."""
    matrix = np.zeros((*np.shape(rotation)[:-2], 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = rotation, translation, 1.0
    return matrix


def turned(vectors: F64) -> F64:
    """(..., 3, 3) rotations by rotation vectors (..., 3), radians (Rodrigues)."""
    angle = np.maximum(np.sqrt((vectors * vectors).sum(-1)), MIN_ANGLE_RAD)
    sine = np.array([math.sin(one) for one in angle.flat]).reshape(angle.shape)
    cosine = np.array([math.cos(one) for one in angle.flat]).reshape(angle.shape)
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*vectors.shape[:-1], 3, 3)
    linear, square = sine / angle, (1 - cosine) / angle**2
    return np.asarray(np.eye(3) + linear[..., None, None] * cross + square[..., None, None] * cross @ cross)


def rotation_vectors(rotations: F64) -> F64:
    """(N, 3) rotation vectors, radians, of rotations (N, 3, 3): axes, as long as the angles, up to half a turn."""
    quaternions = np.array([quaternion_of_matrix(one) for one in rotations]).reshape(-1, 4)
    sine = np.linalg.norm(quaternions[:, :3], axis=1)
    half = np.array([math.atan2(*pair) for pair in zip(sine, quaternions[:, 3], strict=True)])
    scale = np.where(sine > MIN_ANGLE_RAD, 2 * half / np.maximum(sine, MIN_ANGLE_RAD), 2.0)
    return np.asarray(quaternions[:, :3] * scale[:, None])
