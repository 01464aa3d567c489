"""Cameras whose calibration does not fit: what all objects of a frame say of each.

An object beside its 2D box says little: it may be the object. If most objects of an image lie beside their 2D boxes by
the same step, it is the camera, and its 2D boxes would draw every object aside.
"""

import numpy as np

from pipeline.core.arrays import F64, I64, Indices

__all__ = ["camera_shifts"]

SURE = 3.0
"""A common shift of fewer standard deviations may be chance."""

MEDIAN_SPREAD = 1.2533
"""Standard deviation of a median, as a multiple of that of a mean."""


def camera_shifts(camera_rows: I64, residuals_px: F64, variances_px2: F64, *, count: int) -> F64:
    """(C, 2) common shift of the 2D boxes of each camera to the right and down, pixels; 0 where it may be chance.

    Args:
        camera_rows: (P,) row of the camera of each pair.
        residuals_px: (P, 2) how far the centre of each 2D box is to the right of that of the projected box, and below.
        variances_px2: (P, 2) variances to expect of them.
        count: Number of cameras.
    """
    pairs = np.bincount(camera_rows, minlength=count)
    medians = _medians(np.column_stack([residuals_px, variances_px2]), camera_rows, pairs)
    shifts, sigma = medians[:, :2], MEDIAN_SPREAD * np.sqrt(medians[:, 2:] / np.maximum(pairs, 1)[:, None])
    return np.where(np.abs(shifts) > SURE * sigma, shifts, 0.0)


def _medians(values: F64, groups: I64, counts: Indices) -> F64:
    """(G, E) median of the rows (P, E) of each group, whose sizes are `counts`; 0 where there are none."""
    columns = values.T
    order = np.lexsort((columns, np.broadcast_to(groups, columns.shape)))
    ordered = np.append(np.take_along_axis(columns, order, 1), np.zeros((len(columns), 1)), axis=1)
    starts = np.cumsum(counts) - counts
    low, high = (np.where(counts, starts + (counts - at) // 2, -1) for at in (1, 0))
    return np.asarray((ordered[:, low] + ordered[:, high]) / 2).T
