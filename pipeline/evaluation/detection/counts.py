"""Counts, precision and recall: of all that is reported, and at the scores that somebody may choose."""

import numpy as np

from pipeline.evaluation.detection.curves import Curve, ratio
from pipeline.evaluation.records import Figures

__all__ = ["count_figures", "threshold_figures"]

_PRECISIONS = (0.5, 0.8, 0.9)


def f1(right: int, false: int, truth: int) -> float | None:
    """Harmonic mean of precision and recall; None without true objects."""
    return ratio(2 * right, truth + right + false) if truth else None


def best_row(curve: Curve) -> int | None:
    """Row of the highest F1, of equal ones that of the highest score; None where nothing is right."""
    if not len(curve) or not curve.truth or not curve.right[-1]:
        return None
    return int(np.argmax(2 * curve.right / (curve.truth + curve.right + curve.false)))


def operating_point(curve: Curve, row: int | None) -> dict[str, float | None]:
    """Score, precision, recall and F1 where only what has the score of a row of the curve or more is reported."""
    if row is None:
        return dict.fromkeys(("score", "precision", "recall", "f1"))
    right, false = int(curve.right[row]), int(curve.false[row])
    return {
        "score": float(curve.scores[row]),
        "precision": ratio(right, right + false),
        "recall": ratio(right, curve.truth),
        "f1": f1(right, false, curve.truth),
    }


def count_figures(curve: Curve, ignored: int, truth_ignored: int) -> dict[str, float | int | None]:
    """Counts, precision and recall of all that is reported, and at the score of the best F1.

    Args:
        curve: What is right and false.
        ignored: Detections that are neither.
        truth_ignored: True objects that are not evaluated.
    """
    right, false = (int(counts[-1]) if len(curve) else 0 for counts in (curve.right, curve.false))
    best = operating_point(curve, best_row(curve))
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
        "f1": f1(right, false, curve.truth),
        "best_f1": best["f1"],
        "best_f1_score": best["score"],
        "best_f1_precision": best["precision"],
        "best_f1_recall": best["recall"],
    }


def threshold_figures(curve: Curve) -> Figures:
    """Scores to choose a threshold from: that of the best F1, and the lowest that gives each of some precisions."""
    figures: dict[str, Figures] = {"best_f1": operating_point(curve, best_row(curve))}
    for precision in _PRECISIONS:
        reached = np.flatnonzero(curve.precision >= precision)
        row = int(reached[-1]) if len(reached) and curve.truth else None
        figures[f"precision_{100 * precision:.0f}"] = operating_point(curve, row)
    return figures
