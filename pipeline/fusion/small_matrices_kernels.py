"""Elimination in many small matrices, compiled."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.compiled import compiled, inlined

__all__ = ["eliminated", "inverses"]

_BLOCK = "Array(float64, 3, 'C', True)"


@inlined
def _eliminated(matrices: F64, found: F64) -> tuple[F64, F64]:
    """As `eliminated`, of right sides that become the solutions."""
    log_determinants = np.zeros(len(matrices))
    size = matrices.shape[1]
    for m in range(len(matrices)):
        table, own = matrices[m].copy(), found[m]
        for j in range(size):
            pivot = table[j, j]
            log_determinants[m] += np.log(pivot)
            for column in range(j + 1, size):
                table[j, column] /= pivot
            for column in range(own.shape[1]):
                own[j, column] /= pivot
            for row in range(size):
                if row != j:
                    factor = table[row, j]
                    for column in range(j + 1, size):
                        table[row, column] -= factor * table[j, column]
                    for column in range(own.shape[1]):
                        own[row, column] -= factor * own[j, column]
    return found, log_determinants


@compiled(f"Tuple((float64[:, :, ::1], float64[::1]))({_BLOCK}, {_BLOCK})")
def eliminated(matrices: F64, right: F64) -> tuple[F64, F64]:
    """Gauss-Jordan elimination without a search for pivots: symmetric positive definite matrices need none.

    Args:
        matrices: (M, D, D).
        right: (M, D, E) right sides.

    Returns:
        (M, D, E) solutions, and (M,) logarithms of the determinants, NaN where a matrix is not positive.
    """
    return _eliminated(matrices, right.copy())


@compiled(f"float64[:, :, ::1]({_BLOCK})")
def inverses(matrices: F64) -> F64:
    """(M, D, D) inverses of matrices (M, D, D), as by `eliminated`."""
    right = np.zeros(matrices.shape)
    for m in range(len(matrices)):
        for j in range(matrices.shape[1]):
            right[m, j, j] = 1.0
    return _eliminated(matrices, right)[0]
