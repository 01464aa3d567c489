"""How smoothly objects move.

The path of an object is the mean of each of its places with the five before and the five after, as Autoware has it in
its evaluation without annotations ("perception online evaluator"): who moves evenly stays on it.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, Bools, Indices
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.evaluation.unlabelled.chains import ChainTable, steps_within

__all__ = ["WINDOW", "limits_of", "smoothness_figures"]

WINDOW = 11
"""Boxes that are averaged."""

STOPPED_LENGTHS_PER_S = 0.25
"""An object whose path is slower stands still: 1 m/s for a car."""

MAX_LENGTHS_PER_S, MAX_LENGTHS_PER_S2 = 15.0, 5.0
"""No road user is faster than 60 m/s, or accelerates more than 20 m/s^2, if it is as long as a car."""


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Each box that has five boxes of its chain before it and five after, compared with its path.

    Attributes:
        lateral_m: (W,) from the path to the left.
        longitudinal_m: (W,) along the path.
        yaw_rad: (W,) between the axis of the box and the path, 0 to pi / 2; only of what moves.
        accelerations: (W,) metres a second squared, over the window.
        is_stopped: (W,) bool.
    """

    lateral_m: F64
    longitudinal_m: F64
    yaw_rad: F64
    accelerations: F64
    is_stopped: Bools


def smoothness_figures(table: ChainTable, lengths_m: F64) -> dict[str, float | int | None]:
    """Deviations from smooth motion; None where no chain is long enough.

    Args:
        table: Chains.
        lengths_m: (C,) length of each class.
    """
    windows = _windows(table, lengths_m)
    moving = ~windows.is_stopped
    same = steps_within(table)
    passed_s = np.diff(table.stamps_ns)[same] / 1e9
    lengths = lengths_m[table.class_ids[1:][same]]
    speeds = np.linalg.norm(np.diff(table.xy, axis=0)[same], axis=-1) / passed_s
    limits = lengths_m[table.class_ids[_middles(table)]] * MAX_LENGTHS_PER_S2
    return {
        **_spread_of("lateral_m", np.abs(windows.lateral_m)),
        **_spread_of("longitudinal_m", np.abs(windows.longitudinal_m)),
        **_spread_of("yaw_deg", np.rad2deg(windows.yaw_rad[moving])),
        **_spread_of("stopped_yaw_rate_deg_s", _stopped_yaw_rates(table, windows)),
        "speed_outlier_share": _share(speeds > MAX_LENGTHS_PER_S * lengths),
        "acceleration_outlier_share": _share(windows.accelerations > limits),
    }


def limits_of(length_m: float | None) -> dict[str, float | None]:
    """From which speeds on an object of a length stands still, or cannot be right; None for objects of all classes."""
    scales = {
        "stopped_mps": STOPPED_LENGTHS_PER_S,
        "max_speed_mps": MAX_LENGTHS_PER_S,
        "max_acceleration_mps2": MAX_LENGTHS_PER_S2,
    }
    return {name: None if length_m is None else scale * length_m for name, scale in scales.items()}


def _middles(table: ChainTable) -> Indices:
    """Rows with a whole window around them."""
    half = WINDOW // 2
    rows = np.arange(half, max(half, len(table) - half))
    return np.asarray(rows[table.chains[rows - half] == table.chains[rows + half]])


def _windows(table: ChainTable, lengths_m: F64) -> _Windows:
    half = WINDOW // 2
    rows = _middles(table)
    before, after = rows - half, rows + half
    away = np.zeros((len(rows), 2))  # from the path; summed box by box: all windows at once would be eleven tables
    for step in range(-half, half + 1):
        away -= (table.xy[rows + step] - table.xy[rows]) / WINDOW
    passed_s = (table.stamps_ns[after] - table.stamps_ns[before])[:, None] / 1e9
    velocities = (table.xy[after] - table.xy[before]) / passed_s
    speeds = np.linalg.norm(velocities, axis=-1)
    is_stopped = speeds < STOPPED_LENGTHS_PER_S * lengths_m[table.class_ids[rows]]
    # What stands still has no path: there, the box says where it looks.
    course = np.where(is_stopped, table.yaws[rows], np.arctan2(velocities[:, 1], velocities[:, 0]))
    cos, sin = np.cos(course), np.sin(course)
    turned = np.abs(wrap_angle(table.yaws[rows] - course))
    first_s, second_s = (
        (table.stamps_ns[stop] - table.stamps_ns[start])[:, None] / 1e9
        for start, stop in ((before, rows), (rows, after))
    )
    change = (table.xy[after] - table.xy[rows]) / second_s - (table.xy[rows] - table.xy[before]) / first_s
    return _Windows(
        away[:, 1] * cos - away[:, 0] * sin,
        away[:, 0] * cos + away[:, 1] * sin,
        np.minimum(turned, np.pi - turned),
        np.linalg.norm(change / (passed_s / 2), axis=-1),
        is_stopped,
    )


def _stopped_yaw_rates(table: ChainTable, windows: _Windows) -> F64:
    """Degrees a second that the axis of a box turns from one box to the next where the object stands still."""
    rows = _middles(table)[windows.is_stopped]
    turned = np.abs(wrap_angle(table.yaws[rows] - table.yaws[rows - 1]))
    passed_s = (table.stamps_ns[rows] - table.stamps_ns[rows - 1]) / 1e9
    return np.asarray(np.rad2deg(np.minimum(turned, np.pi - turned)) / passed_s)


def _spread_of(name: str, values: F64) -> dict[str, float | None]:
    some = len(values) > 0
    return {
        f"{name}_mean": float(values.mean()) if some else None,
        f"{name}_p90": float(np.percentile(values, 90)) if some else None,
    }


def _share(flags: Bools) -> float | None:
    return float(flags.mean()) if len(flags) else None
