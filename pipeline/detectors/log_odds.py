"""Probabilities as log odds, log p / (1 - p), and back."""

import numpy as np

from lidcam.pipeline.core.arrays import F64

SCORE_LIMIT = 0.002
"""Minimum distance of a score from 0 and 1."""


def logit(scores: F64) -> F64:
    """Log odds of scores in [0, 1], which are limited by `SCORE_LIMIT`."""
    limited = scores.clip(SCORE_LIMIT, 1 - SCORE_LIMIT)
    return np.asarray(np.log(limited / (1 - limited)))


def softly_limited(log_odds: F64, limit: float) -> F64:
    """Log odds within +-`limit` in the same order, those well within it as they are.

    A plain limit would make all alike that are certain.
    """
    return np.asarray(log_odds / (1 + (log_odds / limit) ** 4) ** 0.25)


def softmax(log_odds: F64) -> F64:
    """Probabilities of log odds, or of log likelihoods, of which one is true, along the last axis."""
    shares = np.exp(log_odds - log_odds.max(-1, keepdims=True))
    return np.asarray(shares / shares.sum(-1, keepdims=True))


def sigmoid(log_odds: F64) -> F64:
    """Probabilities of log odds."""
    return np.asarray(1 / (1 + np.exp(-log_odds)))
