"""How far all 2D boxes of a camera are shifted: its calibration is off, or its image is late."""

from pipeline.core.arrays import F64, I64
from pipeline.core.association import FREEDOM
from pipeline.fusion.matching.agreement_kernels import shifts_of_others

__all__ = ["common_shifts"]


def common_shifts(
    seen_cameras: I64, prior: F64, matched: I64, away_px: F64, variances: F64, squared: F64
) -> tuple[F64, F64]:
    """The shift that each pair has to expect, by the other pairs of its camera.

    A mean with the weights of the t distribution, of which the calibration's own uncertainty is a part with mean 0. No
    pair speaks for itself: from each, its own share is taken off.

    Args:
        seen_cameras: (P,) camera of each projected 3D box.
        prior: (P, 2) variance of u and v by the calibration, pixels^2.
        matched: (T,) rows of those that are matched, each at most once.
        away_px: (T, 2) centre of the 2D box less that of the projected 3D box.
        variances: (T, 2) of these, without `prior`.
        squared: (T,) how far the 2D box lies off in all, in standard deviations, squared.

    Returns:
        (P, 2) shifts of u and v in pixels, and (P, 2) their variances.
    """
    return shifts_of_others(seen_cameras, prior, matched, away_px, variances, squared, FREEDOM)
