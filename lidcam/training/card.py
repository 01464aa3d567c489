"""The model card of weights: what they were trained on, and how they do in other worlds."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.training.examples import Examples
from lidcam.training.fit import PRIORS, log_loss

BINS = 10
LEAST = 0.05
"""The calibration error leaves out lower probabilities: for each kind, nearly all boxes are clearly not of it."""


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
        cells = [
            f"{is_true.sum()}",
            f"{(taken & is_true).sum()}",
            f"{(taken & ~is_true).sum()}",
            f"{average_precision(score, is_true):.3f}",
            f"{calibration_error(score, is_true, PRIORS[kinds]):.3f}",
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", f"Log loss {log_loss(probabilities, kinds):.4f}."])


def average_precision(score: F64, is_true: Bools) -> float:
    """Mean, over the true boxes, of the precision among the boxes (N,) that score as high; NaN if none is true."""
    order = np.argsort(-score, kind="stable")
    right = np.cumsum(is_true[order])
    precision = right / np.arange(1, len(order) + 1)
    return float(precision[is_true[order]].mean()) if right.size and right[-1] else float("nan")


def calibration_error(score: F64, is_true: Bools, weights: F64) -> float:
    """Mean difference over bins between probability and share of true boxes (Naeini et al., 2015), from `LEAST` up.

    Args:
        score: (N,) probabilities.
        is_true: (N,) whether each is true.
        weights: (N,) how much each box counts.
    """
    kept = score >= LEAST
    score, weights, is_true = score[kept], weights[kept], is_true[kept]
    row = np.minimum((score * BINS).astype(np.int64), BINS - 1)
    difference = np.bincount(row, weights * (score - is_true), minlength=BINS)
    return float(np.abs(difference).sum() / max(weights.sum(), 1e-12))
