"""Average precision over recall, from detections by falling score.

That by distance of the centres is as nuScenes has it: Caesar et al., nuScenes: a multimodal dataset for autonomous
driving, CVPR 2020, section 3.1; where the paper leaves something open, as its devkit does it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, Table

_RECALLS = np.linspace(0, 1, 101)
_MIN_PRECISION = 0.1
_FIRST = 11
"""Row of the first recall above 0.1."""

RECALLS = 40
"""Number of recalls, 1/40 to 1 (Simonelli et al., Disentangling monocular 3D object detection, ICCV 2019, 5)."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve(Table):
    """Counts of right and false detections from each score upwards; detections of equal score count together."""

    scores: F64  # (P,) float64, falling
    right: I64  # (P,) int64, detections that are right, of this score and above
    false: I64  # (P,) int64, those that are false
    truth: int  # True objects

    @property
    def precision(self) -> F64:
        """(P,) share of right ones among the detections."""
        return self.right / (self.right + self.false)


def curve_of(scores: F32, is_right: Bools, truth: int) -> Curve:
    """The curve of detections (N,) by falling score; `is_right` (N,), and the number of true objects."""
    last = last_of_equals(scores)
    right = np.cumsum(is_right, dtype=np.int64)[last]
    return Curve(scores[last].astype(np.float64), right, last + 1 - right, truth)


def last_of_equals(scores: F32) -> I64:
    """The last row of each run of equal scores (N,)."""
    return np.flatnonzero(np.append(scores[1:] != scores[:-1], np.ones(min(len(scores), 1), np.bool_)))


def average_precision(right: npt.NDArray[np.integer], quality: F64, truth: int) -> float | None:
    """Mean over 40 recalls of the best precision at that recall or a higher one.

    The curve is read at every score that occurs. KITTI's own program reads it at up to 41 of them, chosen among the
    scores of right detections, and differs by what lies between.

    Args:
        right: (P,) detections that are right from each score upwards, rising.
        quality: (P,) their share among all detections.
        truth: True objects.

    Returns:
        In [0, 1]; recalls that are not reached count as 0. None without true objects.
    """
    if not truth:
        return None
    best = np.append(np.maximum.accumulate(quality[::-1])[::-1], 0.0)
    reached = np.searchsorted(right * RECALLS, np.arange(1, RECALLS + 1) * truth, side="left")  # in whole numbers
    return float(best[reached].mean())


def ratio(part: float, whole: float) -> float | None:
    """`part` of `whole`; None if there is no whole."""
    return float(part / whole) if whole else None


def interpolated_ap(is_right: Bools, truth: int) -> float:
    """Mean precision beyond 0.1 at the recalls above 0.1, as a share of its maximum; 0 without detections.

    `is_right` (N,) by falling score; `truth` is not 0.
    """
    if not len(is_right):
        return 0.0
    right = np.cumsum(is_right)
    read = np.interp(_RECALLS, right / truth, right / np.arange(1, len(right) + 1), right=0)[_FIRST:]
    return float(np.maximum(read - _MIN_PRECISION, 0).mean() / (1 - _MIN_PRECISION))
