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

    ALONG, ACROSS, UP, LENGTH, WIDTH, HEIGHT, YAW, NEES = range(8)


CHI2_95 = 5.991464547107979
"""95th percentile of chi-square with two degrees of freedom."""


def errors_of_pairs(found: Boxes3D, truth: TruthBoxes3D, rows: Indices, columns: Indices | I32) -> F64:
    """Errors of the detections `rows` (P,), which show the true objects `columns` (P,): detection minus truth.

    Returns:
        (P, 8): along and across the object's heading, up, length, width, height (metres), yaw (radians, in (-pi, pi]),
        and the squared errors of x and y over what the covariance of the detection lets expect; NaN without a usable
        covariance.
    """
    gap_m = found.centers[rows] - truth.centers[columns]
    cos, sin = np.cos(truth.yaws[columns]), np.sin(truth.yaws[columns])
    along_m, across_m = gap_m[:, 0] * cos + gap_m[:, 1] * sin, gap_m[:, 1] * cos - gap_m[:, 0] * sin
    sizes, true_sizes = found.sizes[rows], truth.sizes[columns]
    turn = wrap_angle(found.yaws[rows] - truth.yaws[columns])
    nees = _normalised(gap_m[:, :2], found.covariances[rows][:, :2, :2])
    return np.column_stack([along_m, across_m, gap_m[:, 2], sizes - true_sizes, turn, nees])


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


_SIGNED = ("along_m", "across_m", "z_m", "length_m", "width_m", "height_m")  # the first of `Column`


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
    """Figures of errors (N, 8) as of `errors_of_pairs`; a flip is a heading that is wrong by more than 90 degrees."""
    turns_deg = np.degrees(np.abs(errors[:, Column.YAW], dtype=np.float64))
    figures: dict[str, Figures | float | None] = {"position_bev_m": spread(bird_eye_m(errors))}
    for column, name in enumerate(_SIGNED):
        figures[name] = {"bias": bias(errors[:, column]), **spread(errors[:, column])}
    figures["heading_deg"] = spread(turns_deg)
    figures["heading_mod_180_deg"] = spread(np.minimum(turns_deg, 180 - turns_deg))
    figures["nees"] = nees_figures(errors[:, Column.NEES])
    figures["flips"] = float(is_flip(errors[:, Column.YAW]).mean()) if len(errors) else None
    return figures


def nees_figures(nees: npt.NDArray[np.floating]) -> dict[str, float | int | None]:
    """Number and mean of normalised errors (N,), NaN left out, and their share within the 95 % ellipse."""
    known = nees[~np.isnan(nees)].astype(np.float64)
    count = len(known)
    if not count:
        return {"count": 0, "mean": None, "inside_95": None}
    return {"count": count, "mean": float(known.mean()), "inside_95": float((known <= CHI2_95).mean())}


def motion_figures(
    errors: npt.NDArray[np.floating], motion_errors: npt.NDArray[np.floating], moves: Bools
) -> dict[str, Figures | float | int | None]:
    """The figures of the motion of detections that show an object.

    Args:
        errors: (N, 8) as of `errors_of_pairs`.
        motion_errors: (N, 3) velocity along x and y of the ground in m/s, and yaw rate in rad/s, found minus true; NaN
            where either is not known.
        moves: (N,) whether the object moves in the recording.
    """
    velocities = motion_errors[~np.isnan(motion_errors[:, :2]).any(1), :2].astype(np.float64)
    yaw_rates_deg_s = np.degrees(motion_errors[~np.isnan(motion_errors[:, 2]), 2].astype(np.float64))
    is_flipped = is_flip(errors[:, Column.YAW])
    return {
        "velocity_m_s": {"count": len(velocities), **spread(np.hypot(velocities[:, 0], velocities[:, 1]))},
        "yaw_rate_deg_s": {"count": len(yaw_rates_deg_s), "bias": bias(yaw_rates_deg_s), **spread(yaw_rates_deg_s)},
        "flips_moving": float(is_flipped[moves].mean()) if moves.any() else None,
    }


def bird_eye_m(errors: npt.NDArray[np.floating]) -> F64:
    """(N,) distance of the centres seen from above."""
    return np.hypot(errors[:, Column.ALONG].astype(np.float64), errors[:, Column.ACROSS].astype(np.float64))
