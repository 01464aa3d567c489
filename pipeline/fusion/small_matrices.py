"""Many small symmetric systems at once, in plain array arithmetic: the same bits on every machine."""

import numpy as np

from pipeline.core.arrays import F64

__all__ = ["inverse", "inverse_3x3", "solve"]


def solve(matrices: F64, right: F64) -> tuple[F64, F64]:
    """Solutions of symmetric positive definite systems, by Gauss-Jordan elimination: few steps, each for everything.

    Args:
        matrices: (D, D, ...) with the matrices along the first two axes.
        right: (D, E, ...) right sides.

    Returns:
        (D, E, ...) solutions, and (...) logarithms of the determinants: these are not finite where a matrix is
        not positive.
    """
    size = len(matrices)
    table = np.concatenate([matrices, right], axis=1)
    log_det = np.zeros(matrices.shape[2:])
    for j in range(size):
        pivot = table[j, j]
        log_det += np.log(pivot)
        row = table[j, j + 1 :] / pivot
        table[:, j + 1 :] -= table[:, j, None] * row
        table[j, j + 1 :] = row
    return table[:, size:], log_det


def inverse(matrices: F64) -> F64:
    """(..., D, D) inverses of symmetric positive definite matrices (..., D, D)."""
    size = matrices.shape[-1]
    leading = np.moveaxis(matrices, (-2, -1), (0, 1))
    unit = np.broadcast_to(np.eye(size).reshape(size, size, *[1] * (leading.ndim - 2)), leading.shape)
    return np.moveaxis(solve(leading, unit)[0], (0, 1), (-2, -1))


def inverse_3x3(matrices: F64) -> F64:
    """(N, 3, 3) inverses of regular symmetric matrices (N, 3, 3), by cofactors: quicker for few of them."""
    a, b, c = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 0, 2]
    d, e, f = matrices[:, 1, 1], matrices[:, 1, 2], matrices[:, 2, 2]
    found = np.empty_like(matrices)
    found[:, 0, 0], found[:, 1, 1], found[:, 2, 2] = d * f - e * e, a * f - c * c, a * d - b * b
    found[:, 0, 1] = found[:, 1, 0] = c * e - b * f
    found[:, 0, 2] = found[:, 2, 0] = b * e - c * d
    found[:, 1, 2] = found[:, 2, 1] = b * c - a * e
    determinant = a * found[:, 0, 0] + b * found[:, 0, 1] + c * found[:, 0, 2]
    return found / determinant[:, None, None]
