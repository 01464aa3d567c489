"""Cameras whose calibration does not fit: what all objects of a frame say of each.

An object beside its 2D box says little: it may be the object. If most objects of an image lie beside their 2D boxes by
the same step, it is the camera, and its 2D boxes would draw every object aside.
"""

from pipeline.core.arrays import F64, I64
from pipeline.fusion.refining.edge_kernels import median_shifts

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
    return median_shifts(camera_rows, residuals_px, variances_px2, count, SURE, MEDIAN_SPREAD)
