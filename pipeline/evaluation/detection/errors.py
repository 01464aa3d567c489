"""Errors of detections that show an object."""

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64, I32, Bools, Indices
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.evaluation.evaluation_frame import Figures, TruthBoxes3D
from lidcam.pipeline.evaluation.scales import is_flip

MIN_VARIANCE = 1e-12
"""Smallest variance along an axis of a usable covariance; less is rounding."""

MAX_VARIANCE = 1e12
"""Largest element of a usable covariance; more overflows."""

MIN_RATIO = 1e-10
"""Smallest ratio of the variances along the axes of a usable covariance; less is rounding."""


class Column(IntEnum):
    """Columns of the errors of a match: see `errors_of_pairs`."""

    ALONG = 0
    ACROSS = 1
    UP = 2
    LENGTH = 3
    WIDTH = 4
    HEIGHT = 5
    YAW = 6
    SCALE = 7
    NEES = 8
    NEES_YAW = 9


CHI2_95 = {Column.NEES: 5.991464547107979, Column.NEES_YAW: 7.814727903251179}
"""95th percentiles of chi-square with two and with three degrees of freedom."""


def errors_of_pairs(found: Boxes3D, truth: TruthBoxes3D, rows: Indices, columns: Indices | I32) -> F64:
    """Errors of the detections `rows` (P,), which show the true objects `columns` (P,): detection minus truth.

    Returns:
        (P, 10): along and across the object's heading, up, length, width, height (metres), yaw (radians, in (-pi, pi]),
        1 - IoU of the sizes alone, as if centre and yaw agreed, and the squared errors over what the covariance of the
        detection lets expect: of x and y, and of x, y and yaw modulo 180 degrees; NaN without a usable covariance.
    """
    gap_m = found.centers[rows] - truth.centers[columns]
    cos, sin = np.cos(truth.yaws[columns]), np.sin(truth.yaws[columns])
    along_m, across_m = gap_m[:, 0] * cos + gap_m[:, 1] * sin, gap_m[:, 1] * cos - gap_m[:, 0] * sin
    sizes, true_sizes = found.sizes[rows], truth.sizes[columns]
    shared_m3 = np.minimum(sizes, true_sizes).prod(1)
    joined_m3 = sizes.prod(1) + true_sizes.prod(1) - shared_m3
    scale = 1 - np.divide(shared_m3, joined_m3, out=np.zeros(len(rows)), where=joined_m3 > 0)
    turn = wrap_angle(found.yaws[rows] - truth.yaws[columns])
    axis_turn = wrap_angle(2 * turn) / 2
    covariances = found.covariances[rows]
    nees = _normalised(gap_m[:, :2], covariances[:, :2, :2])
    nees_yaw = _normalised(np.column_stack([gap_m[:, :2], axis_turn]), covariances)
    return np.column_stack([along_m, across_m, gap_m[:, 2], sizes - true_sizes, turn, scale, nees, nees_yaw])


def _normalised(errors: F64, covariances: F64) -> F64:
    """(P,) normalised estimation error squared e' inv(P) e of errors (P, D); NaN where P is not positive definite.

    Bar-Shalom, Li and Kirubarajan, Estimation with applications to tracking and navigation, 2001, 5.4.2.
    """
    found = np.full(len(errors), np.nan)
    rows = np.flatnonzero((np.abs(covariances) < MAX_VARIANCE).all((1, 2)))
    symmetric = (covariances[rows] + covariances[rows].swapaxes(1, 2)) / 2
    values = np.linalg.eigvalsh(symmetric)
    is_usable = values[:, 0] > np.maximum(MIN_VARIANCE, MIN_RATIO * values[:, -1])
    rows, symmetric = rows[is_usable], symmetric[is_usable]
    e = errors[rows, :, None]
    found[rows] = (e * np.linalg.solve(symmetric, e)).sum((1, 2))
    return found


_SIGNED = {
    "along_m": Column.ALONG,
    "across_m": Column.ACROSS,
    "z_m": Column.UP,
    "length_m": Column.LENGTH,
    "width_m": Column.WIDTH,
    "height_m": Column.HEIGHT,
}


def spread(errors: npt.NDArray[np.floating]) -> dict[str, float | None]:
    """Mean, root of the mean square, percentiles and maximum of the magnitudes of errors (N,)."""
    names = ("mean", "rmse", "p50", "p90", "p95", "max")
    if not len(errors):
        return dict.fromkeys(names)
    magnitudes = np.abs(errors, dtype=np.float64)
    rmse = np.sqrt(np.mean(magnitudes**2))
    values = (magnitudes.mean(), rmse, *np.percentile(magnitudes, (50, 90, 95)), magnitudes.max())
    return dict(zip(names, map(float, values), strict=True))


def bias(errors: npt.NDArray[np.floating]) -> float | None:
    """Mean of signed errors (N,), found minus true."""
    return float(errors.mean(dtype=np.float64)) if len(errors) else None


def error_figures(errors: npt.NDArray[np.floating]) -> Figures:
    """Figures of errors (N, 10) as of `errors_of_pairs`; a flip is a heading that is wrong by more than 90 degrees."""
    turns_deg = np.degrees(np.abs(errors[:, Column.YAW], dtype=np.float64))
    figures: dict[str, Figures | float | None] = {"position_bev_m": spread(bird_eye_m(errors))}
    for name, column in _SIGNED.items():
        figures[name] = {"bias": bias(errors[:, column]), **spread(errors[:, column])}
    figures["heading_deg"] = spread(turns_deg)
    figures["heading_mod_180_deg"] = spread(np.minimum(turns_deg, 180 - turns_deg))
    figures["nees"] = nees_figures(errors[:, Column.NEES], CHI2_95[Column.NEES])
    figures["nees_yaw"] = nees_figures(errors[:, Column.NEES_YAW], CHI2_95[Column.NEES_YAW])
    figures["flips"] = float(is_flip(errors[:, Column.YAW]).mean()) if len(errors) else None
    return figures


def nees_figures(nees: npt.NDArray[np.floating], limit: float) -> dict[str, float | int | None]:
    """Number and mean of normalised errors (N,), NaN left out, and their share below the 95th percentile `limit`."""
    known = nees[~np.isnan(nees)].astype(np.float64)
    count = len(known)
    if not count:
        return {"count": 0, "mean": None, "inside_95": None}
    return {"count": count, "mean": float(known.mean()), "inside_95": float((known <= limit).mean())}


def motion_figures(
    errors: npt.NDArray[np.floating], motion_errors: npt.NDArray[np.floating], moves: Bools, stands: Bools
) -> dict[str, Figures | float | int | None]:
    """The figures of the motion of detections that show an object.

    Args:
        errors: (N, 10) as of `errors_of_pairs`.
        motion_errors: (N, 3) velocity along x and y of the ground in m/s, and yaw rate in rad/s, found minus true; NaN
            where either is not known.
        moves: (N,) whether the object moves in the recording.
        stands: (N,) whether it stands.
    """
    velocities = motion_errors[~np.isnan(motion_errors[:, :2]).any(1), :2].astype(np.float64)
    yaw_rates_deg_s = np.degrees(motion_errors[~np.isnan(motion_errors[:, 2]), 2].astype(np.float64))
    is_flipped = is_flip(errors[:, Column.YAW])
    return {
        "velocity_m_s": {"count": len(velocities), **spread(np.hypot(velocities[:, 0], velocities[:, 1]))},
        "yaw_rate_deg_s": {
            "count": len(yaw_rates_deg_s),
            "bias": bias(yaw_rates_deg_s),
            **spread(yaw_rates_deg_s),
        },
        "flips_moving": float(is_flipped[moves].mean()) if moves.any() else None,
        "flips_standing": float(is_flipped[stands].mean()) if stands.any() else None,
    }


def bird_eye_m(errors: npt.NDArray[np.floating]) -> F64:
    """(N,) distance of the centres seen from above."""
    return np.hypot(errors[:, Column.ALONG].astype(np.float64), errors[:, Column.ACROSS].astype(np.float64))
