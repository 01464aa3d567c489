"""The sums of `merging.py`: everything between the functions whose last bit differs between machines."""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["combine", "mixture_means", "near_worth"]

_ROWS = "Array(int64, 1, 'C', True)"
_LIST, _TABLE, _BLOCK, _BLOCKS = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3, 4))


@inlined
def _summed(values: F64) -> float:
    """The sum of less than 128 numbers, in numpy's order: of eight and eight, then one after another."""
    count, total = len(values), 0.0
    eights = count - count % 8
    if eights:
        part = np.empty(8)
        for k in range(8):
            part[k] = values[k]
            for i in range(8 + k, eights, 8):
                part[k] += values[i]
        total = ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]))
    for i in range(eights, count):
        total += values[i]
    return total


@compiled(
    f"Tuple((float64[:, ::1], float64[:, :, ::1], float64[::1], float64[::1]))({_TABLE}, {_BLOCK}, {_BLOCKS}, {_TABLE})"
)
def mixture_means(weights: F64, xy: F64, covariances: F64, directions: F64) -> tuple[F64, F64, F64, F64]:
    """Means and covariances of mixtures of normal distributions over H headings.

    Args:
        weights: (P, H) positive, up to a factor for each.
        xy: (P, H, 2) means.
        covariances: (P, H, 2, 2).
        directions: (2, H) unit vectors, of which the mean is taken, too.

    Returns:
        (P, 2) means, (P, 2, 2) covariances, and (P,) x and (P,) y of the mean direction.
    """
    count, headings = weights.shape
    mean, spread, x, y = np.zeros((count, 2)), np.zeros((count, 2, 2)), np.empty(count), np.empty(count)
    share, part = np.empty(headings), np.empty(headings)
    for p in range(count):
        total = _summed(weights[p])
        for h in range(headings):
            share[h] = weights[p, h] / total
            for i in range(2):
                mean[p, i] += share[h] * xy[p, h, i]
        for h in range(headings):
            for i in range(2):
                for j in range(2):
                    gaps = (xy[p, h, i] - mean[p, i]) * (xy[p, h, j] - mean[p, j])
                    spread[p, i, j] += share[h] * (covariances[p, h, i, j] + gaps)
        for h in range(headings):
            part[h] = share[h] * directions[0, h]
        x[p] = _summed(part)
        for h in range(headings):
            part[h] = share[h] * directions[1, h]
        y[p] = _summed(part)
    return mean, spread, x, y


@compiled(f"float64[:, ::1]({_TABLE}, {_BLOCK}, {_TABLE}, {_BLOCK}, float64)")
def near_worth(first_xy: F64, first: F64, second_xy: F64, second: F64, gate: float) -> F64:
    """(R, C) how much nearer than a gate two places are to each other, 0 outside of it.

    Args:
        first_xy: (R, 2) places.
        first: (R, 2, 2) their covariances.
        second_xy: (C, 2) other places.
        second: (C, 2, 2) their covariances.
        gate: Of the squared Mahalanobis distance, each place being as uncertain as both together.
    """
    worth = np.zeros((len(first), len(second)))
    for r in range(len(first)):
        for k in range(len(second)):
            x, y = second_xy[k, 0] - first_xy[r, 0], second_xy[k, 1] - first_xy[r, 1]
            a, b = first[r, 0, 0] + second[k, 0, 0], first[r, 0, 1] + second[k, 0, 1]
            c = first[r, 1, 1] + second[k, 1, 1]
            inside = gate - (c * x * x - 2 * b * x * y + a * y * y) / (a * c - b * b)
            if inside > 0:
                worth[r, k] = inside
    return worth


@compiled(
    f"Tuple((float64[:, ::1], float64[:, ::1]))(float64[:, :, ::1], float64[:, :, :, ::1], {_BLOCK}, {_BLOCKS}, "
    f"{_ROWS}, {_ROWS})"
)
def combine(
    known_xy: F64, known_covariances: F64, new_xy: F64, new_covariances: F64, rows: I64, new_rows: I64
) -> tuple[F64, F64]:
    """Combine known places, in place, with independent new ones, under each of H headings.

    Args:
        known_xy: (R, H, 2).
        known_covariances: (R, H, 2, 2).
        new_xy: (C, H, 2).
        new_covariances: (C, H, 2, 2).
        rows: (T,) of the known ones, each at most once.
        new_rows: (T,) of the new ones.

    Returns:
        (T, H) squared Mahalanobis distance of both, and (T, H) determinant of the sum of their covariances.
    """
    squares, determinants = np.empty((len(rows), known_xy.shape[1])), np.empty((len(rows), known_xy.shape[1]))
    weight, gain, left = np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 2))
    for t in range(len(rows)):
        for h in range(known_xy.shape[1]):
            xy, p = known_xy[rows[t], h], known_covariances[rows[t], h]
            other_xy, q = new_xy[new_rows[t], h], new_covariances[new_rows[t], h]
            x, y = other_xy[0] - xy[0], other_xy[1] - xy[1]
            a, b, b_too, c = p[0, 0] + q[0, 0], p[0, 1] + q[0, 1], p[1, 0] + q[1, 0], p[1, 1] + q[1, 1]
            # The inverse, by elimination.
            share, rest = b / a, c - b_too * (b / a)
            weight[1, 0], weight[1, 1] = (0.0 - b_too * (1 / a)) / rest, 1 / rest
            weight[0, 0], weight[0, 1] = 1 / a - share * weight[1, 0], 0.0 - share * weight[1, 1]
            for i in range(2):
                for j in range(2):
                    gain[i, j] = p[i, 0] * weight[0, j] + p[i, 1] * weight[1, j]
            squares[t, h] = x * weight[0, 0] * x + x * weight[0, 1] * y + y * weight[1, 0] * x + y * weight[1, 1] * y
            determinants[t, h] = a * c - b * b
            for i in range(2):
                for j in range(2):
                    left[i, j] = p[i, j] - (gain[i, 0] * p[0, j] + gain[i, 1] * p[1, j])
            xy[0] += gain[0, 0] * x + gain[0, 1] * y
            xy[1] += gain[1, 0] * x + gain[1, 1] * y
            for i in range(2):
                for j in range(2):
                    p[i, j] = (left[i, j] + left[j, i]) / 2
    return squares, determinants
