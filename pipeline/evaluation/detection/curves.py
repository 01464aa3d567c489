"""Average precision over recall, from detections by falling score."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pipeline.core.arrays import F32, F64, I64, Bools, check_array

__all__ = ["R11", "R40", "Curve", "Recalls", "average_precision", "curve_of", "last_of_equals", "ratio"]


class Recalls(NamedTuple):
    """Recalls at which precision is read, as fractions: comparisons with counts are exact."""

    numerators: tuple[int, ...]
    denominator: int


R11 = Recalls(tuple(range(11)), 10)
"""Those of Pascal VOC 2007: 0, 0.1, ..., 1 (Everingham et al., The Pascal visual object classes challenge, 2010)."""

R40 = Recalls(tuple(range(1, 41)), 40)
"""1/40, ..., 1 (Simonelli et al., Disentangling monocular 3D object detection, ICCV 2019, section 5)."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """What is right and false from each score upwards; detections of equal score count together.

    Attributes:
        scores: (P,) float64, falling.
        right: (P,) int64, detections that are right, of this score and above.
        false: (P,) int64, those that are false.
        truth: True objects.
    """

    scores: F64
    right: I64
    false: I64
    truth: int

    def __post_init__(self) -> None:
        n = len(self.scores)
        check_array("scores", self.scores, (n,), np.float64)
        check_array("right", self.right, (n,), np.int64)
        check_array("false", self.false, (n,), np.int64)

    def __len__(self) -> int:
        return len(self.scores)

    @property
    def precision(self) -> F64:
        """(P,) share of right ones among the detections."""
        return self.right / (self.right + self.false)


def curve_of(scores: F32, is_right: Bools, truth: int) -> Curve:
    """The curve of detections.

    Args:
        scores: (N,) falling.
        is_right: (N,) which of them show an object.
        truth: True objects.
    """
    last = last_of_equals(scores)
    right = np.cumsum(is_right, dtype=np.int64)[last]
    return Curve(scores[last].astype(np.float64), right, last + 1 - right, truth)


def last_of_equals(scores: F32) -> I64:
    """The last row of each run of equal scores (N,)."""
    return np.flatnonzero(np.append(scores[1:] != scores[:-1], np.ones(min(len(scores), 1), np.bool_)))


def average_precision(right: npt.NDArray[np.integer], quality: F64, truth: int, recalls: Recalls) -> float | None:
    """Mean over some recalls of the best precision at that recall or a higher one.

    The curve is read at every score that occurs. KITTI's own program reads it at up to 41 of them, chosen among the
    scores of right detections, and differs by what lies between.

    Args:
        right: (P,) detections that are right from each score upwards, rising.
        quality: (P,) their share among all detections; or that of their similarities (`aos`).
        truth: True objects.
        recalls: `R40` or `R11`.

    Returns:
        In [0, 1]; recalls that are not reached count as 0. None without true objects.
    """
    if not truth:
        return None
    best = np.append(np.maximum.accumulate(quality[::-1])[::-1], 0.0)
    reached = np.searchsorted(right * recalls.denominator, np.array(recalls.numerators) * truth, side="left")
    return float(best[reached].mean())


def ratio(part: float, whole: float) -> float | None:
    """`part` of `whole`; None if there is no whole."""
    return float(part / whole) if whole else None
