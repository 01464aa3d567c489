"""Elimination in many small matrices, compiled."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.compiled import compiled

__all__ = ["eliminated"]

_BLOCK = "Array(float64, 3, 'C', True)"


@compiled(f"Tuple((float64[:, :, ::1], float64[::1]))({_BLOCK}, {_BLOCK})")
def eliminated(matrices: F64, right: F64) -> tuple[F64, F64]:
    """Gauss-Jordan elimination without a search for pivots: symmetric positive definite matrices need none.

    Args:
        matrices: (M, D, D).
        right: (M, D, E) right sides.

    Returns:
        (M, D, E) solutions, and (M,) logarithms of the determinants, NaN where a matrix is not positive.
    """
    found, log_determinants = right.copy(), np.zeros(len(matrices))
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
