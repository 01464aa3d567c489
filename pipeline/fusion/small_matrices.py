"""Many small symmetric systems at once, without LAPACK: the same bits on every machine."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.fusion.small_matrices_kernels import eliminated, inverses

__all__ = ["inverse", "solve"]


def solve(matrices: F64, right: F64) -> tuple[F64, F64]:
    """Solutions of symmetric positive definite systems.

    Args:
        matrices: (..., D, D).
        right: (..., D, E) right sides.

    Returns:
        (..., D, E) solutions, and (...) logarithms of the determinants: these are not finite where a matrix is not
        positive.
    """
    *shape, size, columns = right.shape
    found, log_determinants = eliminated(
        np.ascontiguousarray(matrices).reshape(-1, size, size), np.ascontiguousarray(right).reshape(-1, size, columns)
    )
    return found.reshape(right.shape), log_determinants.reshape(shape)


def inverse(matrices: F64) -> F64:
    """(..., D, D) inverses of symmetric positive definite matrices (..., D, D)."""
    size = matrices.shape[-1]
    return inverses(np.ascontiguousarray(matrices).reshape(-1, size, size)).reshape(matrices.shape)
