"""How well what was found is placed."""

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from pipeline.core.arrays import F64
from pipeline.evaluation.evaluation_frame import Figures
from pipeline.evaluation.scales import is_flip

__all__ = ["Column", "bias", "bird_eye_m", "error_figures", "spread"]


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
