"""Figures of model cards: how well weights do in worlds and frames that they were not trained on."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.training.examples import Examples

PRIORS = np.array([1.0, 1.0, 0.4, 0.4, 0.6])
"""Weight of an example of each of `KINDS`. Worlds have more people, cyclists and large vehicles than streets, so that
there are enough to learn from; these weights make them count as often as in streets."""

BINS = 10
MIN_PROBABILITY = 0.05  # Of the calibration error: for each kind, nearly all boxes are clearly not of it


def figures(probabilities: F64, examples: Examples) -> str:
    """A Markdown table with a row for each kind except the background."""
    kinds, chosen = examples.kinds, probabilities.argmax(1)
    lines = [
        "| kind | boxes | found | false | average precision | calibration error |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind, name in enumerate(KINDS[1:], 1):
        is_true, score = kinds == kind, probabilities[:, kind]
        taken = (score >= 0.5) & (chosen == kind)
        counts = f"{is_true.sum()} | {(taken & is_true).sum()} | {(taken & ~is_true).sum()}"
        error = calibration_error(score, is_true, PRIORS[kinds])
        lines.append(f"| {name} | {counts} | {average_precision(score, is_true):.3f} | {error:.3f} |")
    return "\n".join([*lines, "", f"Log loss {log_loss(probabilities, kinds):.4f}."])


def log_loss(probabilities: F64, kinds: I64) -> float:
    """Mean negative logarithm of the probability (N, 5) of the true kind (N,), weighted by `PRIORS`."""
    true, share = probabilities[np.arange(len(kinds)), kinds], PRIORS[kinds]
    return float(-(share * np.log(np.maximum(true, 1e-12))).sum() / share.sum())


def average_precision(score: F64, is_true: Bools) -> float:
    """Mean, over the true boxes, of the precision among the boxes (N,) that score as high; NaN if none is true."""
    order = np.argsort(-score, kind="stable")
    right = np.cumsum(is_true[order])
    precision = right / np.arange(1, len(order) + 1)
    return float(precision[is_true[order]].mean()) if right.size and right[-1] else float("nan")


def calibration_error(score: F64, is_true: Bools, weights: F64) -> float:
    """Weighted mean difference between probability and share of true boxes over bins (Naeini et al., 2015).

    Boxes (N,) below `MIN_PROBABILITY` are left out.
    """
    kept = score >= MIN_PROBABILITY
    score, weights, is_true = score[kept], weights[kept], is_true[kept]
    row = np.minimum((score * BINS).astype(np.int64), BINS - 1)
    difference = np.bincount(row, weights * (score - is_true), minlength=BINS)
    return float(np.abs(difference).sum() / max(weights.sum(), 1e-12))
