"""How well what was found is placed."""

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from pipeline.core.arrays import F64, I32, Indices
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.evaluation.evaluation_frame import Figures, TruthBoxes3D
from pipeline.evaluation.scales import is_flip

__all__ = ["Column", "bird_eye_m", "error_figures", "errors_of_pairs"]


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


def errors_of_pairs(found: Boxes3D, truth: TruthBoxes3D, rows: Indices, columns: Indices | I32) -> F64:
    """Errors of the detections `rows` (P,), which show the true objects `columns` (P,): detection minus truth.

    Returns:
        (P, 8): along and across the object's heading, up, length, width, height (metres), yaw (radians, in (-pi, pi]),
        and 1 - IoU of the sizes alone, as if centre and yaw agreed.
    """
    gap_m = found.centers[rows] - truth.centers[columns]
    cos, sin = np.cos(truth.yaws[columns]), np.sin(truth.yaws[columns])
    along_m, across_m = gap_m[:, 0] * cos + gap_m[:, 1] * sin, gap_m[:, 1] * cos - gap_m[:, 0] * sin
    sizes, true_sizes = found.sizes[rows], truth.sizes[columns]
    shared_m3 = np.minimum(sizes, true_sizes).prod(1)
    joined_m3 = sizes.prod(1) + true_sizes.prod(1) - shared_m3
    scale = 1 - np.divide(shared_m3, joined_m3, out=np.zeros(len(rows)), where=joined_m3 > 0)
    turn = wrap_angle(found.yaws[rows] - truth.yaws[columns])
    return np.column_stack([along_m, across_m, gap_m[:, 2], sizes - true_sizes, turn, scale])


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
    """The figures of the errors (N, 8) of detections that show an object.

    A flip is a heading that is wrong by more than 90 degrees.
    """
    turns_deg = np.degrees(np.abs(errors[:, Column.YAW], dtype=np.float64))
    figures: dict[str, Figures | float | None] = {"position_bev_m": spread(bird_eye_m(errors))}
    for name, column in _SIGNED.items():
        figures[name] = {"bias": bias(errors[:, column]), **spread(errors[:, column])}
    figures["heading_deg"] = spread(turns_deg)
    figures["heading_mod_180_deg"] = spread(np.minimum(turns_deg, 180 - turns_deg))
    figures["flips"] = float(is_flip(errors[:, Column.YAW]).mean()) if len(errors) else None
    return figures


def bird_eye_m(errors: npt.NDArray[np.floating]) -> F64:
    """(N,) distance of the centres seen from above."""
    return np.hypot(errors[:, Column.ALONG].astype(np.float64), errors[:, Column.ACROSS].astype(np.float64))
