"""Counts, precision and recall, of all that is reported and by score, and calibration of scores.

Calibration: Guo et al., On calibration of modern neural networks, ICML 2017, section 2.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, Bools
from lidcam.pipeline.evaluation.detection.curves import Curve, ratio
from lidcam.pipeline.evaluation.evaluation_frame import Figures

_BINS = 10


def count_figures(curve: Curve, ignored: int, truth_ignored: int) -> dict[str, float | int | None]:
    """Counts, precision and recall of all that is reported.

    Of detections, `ignored` are neither right nor false; of true objects, `truth_ignored` are not evaluated.
    """
    right, false = (int(counts[-1]) if len(curve) else 0 for counts in (curve.right, curve.false))
    return {
        "truth": curve.truth,
        "truth_ignored": truth_ignored,
        "found": right + false + ignored,
        "right": right,
        "missed": curve.truth - right,
        "false": false,
        "ignored": ignored,
        "precision": ratio(right, right + false),
        "recall": ratio(right, curve.truth),
        "f1": ratio(2 * right, curve.truth + right + false) if curve.truth else None,
    }


def calibration_figures(scores: F32, is_right: Bools) -> Figures:
    """Reliability of scores (N,) in [0, 1] in ten bins, and the calibration error; `is_right` (N,): shows an object."""
    exact = scores.astype(np.float64)
    bins = np.clip((exact * _BINS).astype(np.intp), 0, _BINS - 1)
    counts = np.bincount(bins, minlength=_BINS)
    with np.errstate(invalid="ignore"):
        means = np.bincount(bins, exact, _BINS) / counts
        shares = np.bincount(bins, is_right, _BINS) / counts
    gaps = np.abs(means - shares)[counts > 0]
    return {
        "ece": float(np.average(gaps, weights=counts[counts > 0])) if len(scores) else None,
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
