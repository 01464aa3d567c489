"""The passes of `refinement`, compiled: boxes at the tried states, the systems to solve there, and their average."""

import math

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.compiled import compiled

__all__ = ["averaged_states", "boxes_at", "normal_equations"]

_ROWS = "Array(int64, 1, 'C', True)"
_LIST, _TABLE, _BLOCK, _BLOCKS = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3, 4))

_YAW = 2


@compiled(
    "Tuple((float64[:, ::1], float64[:, ::1], float64[::1]))"
    f"({_BLOCK}, {_ROWS}, {_LIST}, {_TABLE}, {_TABLE}, {_LIST}, {_LIST}, {_LIST}, float64, float64)"
)
def boxes_at(
    states: F64,
    rows: I64,
    later_s: F64,
    centers: F64,
    sizes: F64,
    yaws: F64,
    cosines: F64,
    sines: F64,
    least_size: float,
    most_size: float,
) -> tuple[F64, F64, F64]:
    """The box of each pair, at the time of its image, in each of the states that are tried.

    Args:
        states: (N, K, 7) in the order of `box_prior.STATES`, less the prior's.
        rows: (P,) box of each pair.
        later_s: (P,) how much later its image was measured, seconds.
        centers: (N, 3) of the prior, metres.
        sizes: (N, 3) of the prior, metres.
        yaws: (N,) of the prior, radians.
        cosines: (N,) of these.
        sines: (N,) of these.
        least_size: Bounds of length and width, as shares of the prior's.
        most_size: The upper one.

    Returns:
        (P * K, 3) centres, (P * K, 3) sizes and (P * K,) yaws, all of one pair after another.
    """
    tried = states.shape[1]
    count = len(rows) * tried
    found_centers, found_sizes, found_yaws = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    for p in range(len(rows)):
        n = rows[p]
        for k in range(tried):
            q = p * tried + k
            along, across = states[n, k, 5] * later_s[p], states[n, k, 6] * later_s[p]
            found_centers[q, 0] = centers[n, 0] + (states[n, k, 0] + cosines[n] * along - sines[n] * across)
            found_centers[q, 1] = centers[n, 1] + (states[n, k, 1] + sines[n] * along + cosines[n] * across)
            found_centers[q, 2] = centers[n, 2]
            for i in range(2):
                extent = sizes[n, i] + states[n, k, 3 + i]
                found_sizes[q, i] = min(max(extent, least_size * sizes[n, i]), most_size * sizes[n, i])
            found_sizes[q, 2] = sizes[n, 2]
            found_yaws[q] = yaws[n] + states[n, k, _YAW]
    return found_centers, found_sizes, found_yaws


@compiled(
    "Tuple((float64[:, :, :, ::1], float64[:, :, :, ::1], float64[:, ::1]))"
    f"({_BLOCK}, {_BLOCK}, {_ROWS}, {_TABLE}, {_BLOCK}, {_TABLE}, {_TABLE}, {_TABLE}, {_LIST}, {_LIST}, {_LIST},"
    " float64, float64)"
)
def normal_equations(
    states: F64,
    information: F64,
    rows: I64,
    edges: F64,
    jacobian: F64,
    measured: F64,
    sigma_px: F64,
    limits: F64,
    later_s: F64,
    cosines: F64,
    sines: F64,
    border: float,
    cauchy: float,
) -> tuple[F64, F64, F64]:
    """The linear systems of a Gauss-Newton step, at a given yaw, from each of the states that are tried.

    An edge of a 2D box near the border of its image may be the border: it is compared with the edge of the projection
    clipped to the image, and where that is the border, a small change of the box changes nothing.

    Args:
        states: (N, K, 7) less the prior's.
        information: (N, 7, 7) inverse covariances of the prior.
        rows: (P,) box of each pair.
        edges: (P * K, 4) of the projections of `boxes_at`, pixels.
        jacobian: (P * K, 4, 7) of these by `projection.PARAMETERS`.
        measured: (P, 4) edges of the 2D boxes, pixels.
        sigma_px: (P, 4) their standard deviations.
        limits: (P, 4) the edges that the image has on the right, or below: its size, twice.
        later_s: (P,) how much later the image was measured, seconds.
        cosines: (N,) of the prior's yaws.
        sines: (N,) of these.
        border: An edge is near the border within so many standard deviations.
        cauchy: Residuals of so many standard deviations weigh half.

    Returns:
        (N, K, 6, 6) normal matrices over all states but the yaw; (N, K, 6, 7) their right sides: that of the step, and
        those of the inverse; (N, K) twice the negative logarithm of the probability.
    """
    count, tried = states.shape[:2]
    normal, right, cost = np.zeros((count, tried, 6, 6)), np.zeros((count, tried, 6, 7)), np.zeros((count, tried))
    slope = np.empty(6)
    for p in range(len(rows)):
        n = rows[p]
        for k in range(tried):
            q = p * tried + k
            for e in range(4):
                edge, by_x, by_y = edges[q, e], jacobian[q, e, 0], jacobian[q, e, 1]
                is_cut = False
                if min(measured[p, e], limits[p, e] - measured[p, e]) < border * sigma_px[p, e]:
                    is_cut = edge < 0 or edge > limits[p, e]
                    edge = min(max(edge, 0.0), limits[p, e])
                residual = (measured[p, e] - edge) / sigma_px[p, e]
                squared = (residual / cauchy) ** 2
                cost[n, k] += cauchy**2 * math.log1p(squared)
                if is_cut:
                    continue
                slope[0], slope[1], slope[2], slope[3] = by_x, by_y, jacobian[q, e, 3], jacobian[q, e, 4]
                slope[4] = (by_x * cosines[n] + by_y * sines[n]) * later_s[p]
                slope[5] = (by_y * cosines[n] - by_x * sines[n]) * later_s[p]
                weight = 1 / (1 + squared) / sigma_px[p, e]
                for a in range(6):
                    right[n, k, a, 0] += weight * slope[a] * residual
                    for b in range(6):
                        normal[n, k, a, b] += weight * slope[a] * slope[b] / sigma_px[p, e]

    for n in range(count):
        for k in range(tried):
            for i in range(7):
                drawn_back = 0.0
                for j in range(7):
                    drawn_back += information[n, i, j] * states[n, k, j]
                cost[n, k] += drawn_back * states[n, k, i]
                if i != _YAW:
                    a = i - (i > _YAW)
                    right[n, k, a, 0] -= drawn_back
                    right[n, k, a, 1 + a] = 1.0
                    for j in range(7):
                        if j != _YAW:
                            normal[n, k, a, j - (j > _YAW)] += information[n, i, j]
    return normal, right, cost


@compiled(f"Tuple((float64[:, ::1], float64[:, :, ::1]))({_BLOCK}, {_TABLE}, {_BLOCKS}, {_LIST})")
def averaged_states(states: F64, log_odds: F64, covariances: F64, yaw_variances: F64) -> tuple[F64, F64]:
    """Mean and covariance of the states that were tried.

    Args:
        states: (N, K, 7).
        log_odds: (N, K) logarithms of their probabilities, up to a constant for each box.
        covariances: (N, K, 6, 6) of all but the yaw at each.
        yaw_variances: (N,) of the yaw about each.

    Returns:
        (N, 7) and (N, 7, 7); not a number where a logarithm is not.
    """
    count, tried = log_odds.shape
    mean, spread = np.zeros((count, 7)), np.zeros((count, 7, 7))
    weights = np.empty(tried)
    for n in range(count):
        highest, total = log_odds[n].max(), 0.0
        for k in range(tried):
            weights[k] = math.exp(log_odds[n, k] - highest)
            total += weights[k]
        for k in range(tried):
            for i in range(7):
                mean[n, i] += weights[k] / total * states[n, k, i]
        for k in range(tried):
            for i in range(7):
                for j in range(7):
                    apart = (states[n, k, i] - mean[n, i]) * (states[n, k, j] - mean[n, j])
                    if i != _YAW and j != _YAW:
                        apart += covariances[n, k, i - (i > _YAW), j - (j > _YAW)]
                    spread[n, i, j] += weights[k] / total * apart
        spread[n, _YAW, _YAW] += yaw_variances[n]
    return mean, spread
