"""The sums over matched pairs of `agreement.py`, `aiming.py` and the rounds of association, compiled."""

import numpy as np

from pipeline.core.arrays import F64, I32, I64
from pipeline.core.compiled import compiled

__all__ = ["distances_of_pairs", "shifts_of_others", "sums_of_others"]

_ROWS, _IDS = "Array(int64, 1, 'C', True)", "Array(int32, 1, 'C', True)"
_LIST, _TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3))


@compiled(
    "Tuple((float64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1]))"
    f"({_ROWS}, {_TABLE}, {_BLOCK}, {_BLOCK}, {_TABLE}, {_TABLE}, {_TABLE}, {_TABLE})"
)
def distances_of_pairs(
    seen: I64, differences: F64, jacobians: F64, covariances: F64, moves: F64, noise: F64, shifts: F64, aims: F64
) -> tuple[F64, F64, F64, F64]:
    """How far 2D boxes lie off what is expected of them, by what is said of the place of the 3D boxes.

    Args:
        seen: (Q,) row of the projected rectangle of each pair, of P.
        differences: (Q, 4) features of the 2D boxes less those of the rectangles.
        jacobians: (P, 4, 3) derivatives of the features by x, y and yaw.
        covariances: (P, 3, 3) of these.
        moves: (P, 3) to be added to these.
        noise: (P, 4) variances of the features as far as they do not come from place and camera.
        shifts: (P, 2) to be added to the centres, pixels.
        aims: (P, 2) their variances.

    Returns:
        (Q,) squared distances in standard deviations, (Q, 4) the variances; (Q, 2) how far the centres lie off without
        `shifts`, and (Q, 2) the variances of that without `aims`.
    """
    squared, variances = np.zeros(len(seen)), np.empty((len(seen), 4))
    off, of_off = np.empty((len(seen), 2)), np.empty((len(seen), 2))
    for q in range(len(seen)):
        p = seen[q]
        for f in range(4):
            by_place = 0.0
            for b in range(3):
                slope = 0.0
                for a in range(3):
                    slope += jacobians[p, f, a] * covariances[p, a, b]
                by_place += slope * jacobians[p, f, b]
            by_x, by_y = jacobians[p, f, 0] * moves[p, 0], jacobians[p, f, 1] * moves[p, 1]
            moved = by_x + jacobians[p, f, 2] * moves[p, 2] + by_y  # as einsum adds three products up
            variance, away = noise[p, f] + by_place, differences[q, f]
            if f < 2:
                off[q, f], of_off[q, f] = differences[q, f] - moved, variance
                variance += aims[p, f]
                away -= shifts[p, f]
            away -= moved
            variances[q, f] = variance
            squared[q] += away * away / variance
    return squared, variances, off, of_off


@compiled(
    f"Tuple((float64[:, ::1], float64[:, ::1]))({_ROWS}, {_TABLE}, {_ROWS}, {_TABLE}, {_TABLE}, {_LIST}, float64)"
)
def shifts_of_others(
    seen_cameras: I64, prior: F64, matched: I64, away_px: F64, variances: F64, squared: F64, freedom: float
) -> tuple[F64, F64]:
    """See `aiming.common_shifts`."""
    cameras, own = 0, np.empty((len(matched), 4))
    for camera in seen_cameras:
        cameras = max(cameras, camera + 1)
    total, others = np.zeros((cameras, 4)), np.empty((len(seen_cameras), 4))
    for t in range(len(matched)):
        for axis in range(2):
            own[t, axis] = (freedom + 4) / (freedom + squared[t]) / variances[t, axis]
            own[t, 2 + axis] = own[t, axis] * away_px[t, axis]
        for k in range(4):
            total[seen_cameras[matched[t]], k] += own[t, k]
    for p in range(len(seen_cameras)):
        for k in range(4):
            others[p, k] = total[seen_cameras[p], k]
    for t in range(len(matched)):
        for k in range(4):
            others[matched[t], k] -= own[t, k]
    shifts, left = np.empty((len(seen_cameras), 2)), np.empty((len(seen_cameras), 2))
    for p in range(len(seen_cameras)):
        for axis in range(2):
            left[p, axis] = prior[p, axis] / (1 + prior[p, axis] * others[p, axis])
            shifts[p, axis] = left[p, axis] * others[p, 2 + axis]
    return shifts, left


@compiled(
    "Tuple((float64[:, :, ::1], float64[:, ::1], float64[:, ::1]))"
    f"({_ROWS}, {_BLOCK}, {_TABLE}, {_TABLE}, {_ROWS}, {_IDS}, {_TABLE}, {_TABLE}, {_LIST}, {_BLOCK}, float64)"
)
def sums_of_others(
    seen_rows: I64,
    information: F64,
    log_classes: F64,
    log_confusion: F64,
    matched: I64,
    class_ids: I32,
    differences: F64,
    noise: F64,
    squared: F64,
    jacobians: F64,
    freedom: float,
) -> tuple[F64, F64, F64]:
    """What each box says of itself and the pairs of the other cameras say of it, for each rectangle.

    Args:
        seen_rows: (P,) box of each rectangle.
        information: (N, 3, 3) inverse covariances of the boxes.
        log_classes: (N, K) of the boxes.
        log_confusion: (K, K) logarithms of `BoxBelief.confusion`.
        matched: (T,) and so on: the fields of `MatchedPairs`.
        class_ids: (T,)
        differences: (T, 4)
        noise: (T, 4)
        squared: (T,)
        jacobians: (T, 4, 3)
        freedom: Degrees of freedom of the t distribution.

    Returns:
        (P, 3, 3) normal matrices and (P, 3) right sides over x, y and yaw; (P, K) logarithms of the classes.
    """
    boxes, classes, pairs, views = len(information), log_classes.shape[1], len(matched), len(seen_rows)
    # One row of each: the normal matrix, the right side, the classes.
    own, total = np.zeros((pairs, 12 + classes)), np.zeros((boxes, 12 + classes))
    for t in range(pairs):
        for f in range(4):
            weight = (freedom + 4) / (freedom + squared[t]) / noise[t, f]
            for a in range(3):
                slope = jacobians[t, f, a] * weight
                for b in range(3):
                    own[t, 3 * a + b] += slope * jacobians[t, f, b]
                own[t, 9 + a] += slope * differences[t, f]
        for k in range(classes):
            own[t, 12 + k] = log_confusion[k, class_ids[t]]
        for i in range(12 + classes):
            total[seen_rows[matched[t]], i] += own[t, i]
    others = np.empty((views, 12 + classes))
    for p in range(views):
        for i in range(12 + classes):
            others[p, i] = total[seen_rows[p], i]
    for t in range(pairs):
        for i in range(12 + classes):
            others[matched[t], i] -= own[t, i]
    normal, pull, log_given = np.empty((views, 3, 3)), np.empty((views, 3)), np.empty((views, classes))
    for p in range(views):
        for a in range(3):
            for b in range(3):
                normal[p, a, b] = information[seen_rows[p], a, b] + others[p, 3 * a + b]
            pull[p, a] = others[p, 9 + a]
        for k in range(classes):
            log_given[p, k] = log_classes[seen_rows[p], k] + others[p, 12 + k]
    return normal, pull, log_given
