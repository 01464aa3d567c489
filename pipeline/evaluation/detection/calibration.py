"""Whether scores are probabilities: reliability table and calibration errors.

Guo et al., On calibration of modern neural networks, ICML 2017, section 2; Brier, Verification of forecasts expressed
in terms of probability, 1950.
"""

import numpy as np

from pipeline.core.arrays import F32, Bools
from pipeline.evaluation.records import Figures

__all__ = ["calibration_figures"]

_BINS = 10


def calibration_figures(scores: F32, is_right: Bools) -> Figures:
    """Reliability in ten bins of equal width, and what it comes to.

    Args:
        scores: (N,) in [0, 1], of the detections that count.
        is_right: (N,) which of them show an object.
    """
    exact = scores.astype(np.float64)
    bins = np.clip((exact * _BINS).astype(np.intp), 0, _BINS - 1)
    counts = np.bincount(bins, minlength=_BINS)
    with np.errstate(invalid="ignore"):
        means = np.bincount(bins, exact, _BINS) / counts
        shares = np.bincount(bins, is_right, _BINS) / counts
    gaps = np.abs(means - shares)[counts > 0]
    return {
        "ece": float(np.average(gaps, weights=counts[counts > 0])) if len(scores) else None,
        "mce": float(gaps.max()) if len(scores) else None,
        "brier": float(np.mean((exact - is_right) ** 2)) if len(scores) else None,
        "reliability": [
            {
                "from": row / _BINS,
                "to": (row + 1) / _BINS,
                "count": int(counts[row]),
                "mean_score": float(means[row]) if counts[row] else None,
                "right": float(shares[row]) if counts[row] else None,
            }
            for row in range(_BINS)
        ],
    }
