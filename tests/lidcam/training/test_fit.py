"""Training: what examples are, slopes, what is learned, calibration."""

from dataclasses import replace

import numpy as np
import pytest

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.training import fit
from lidcam.training.card import calibration_error, figures
from lidcam.training.examples import Examples, kinds_of_boxes
from lidcam.training.fit import calibrated, fitted, log_loss


def examples(count: int, seed: int = 0) -> Examples:
    """Boxes whose kind shows in three features; one in ten is called by another kind."""
    draw = np.random.default_rng(seed)
    kinds: I64 = draw.integers(0, 5, count)
    features = draw.normal(size=(count, len(FEATURES)))
    features[:, :3] += 3 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])[kinds]
    return Examples(features, np.where(draw.random(count) < 0.1, draw.integers(0, 5, count), kinds))


def test_a_box_is_what_stands_nearest_within_its_gate() -> None:
    truth, kinds = np.array([[10.0, 0.0], [10.0, 1.5], [30.0, 0.0]]), np.array([1, 2, 4])
    boxes = np.array([[10.5, 0.0], [10.0, 1.2], [12.5, 0.0], [32.4, 0.0], [10.0, 2.2]])
    assert kinds_of_boxes(boxes, truth, kinds).tolist() == [1, 2, 0, 4, 0]
    assert kinds_of_boxes(boxes, truth[:0], kinds[:0]).tolist() == [0] * 5
    assert kinds_of_boxes(boxes[:0], truth, kinds).shape == (0,)


def test_slopes_are_those_of_the_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "DROPPED", 0.0)
    draw = np.random.default_rng(1)
    weights, biases = [draw.normal(size=(4, 6)), draw.normal(size=(6, 5))], [draw.normal(size=6), draw.normal(size=5)]
    inputs, kinds, share = draw.normal(size=(9, 4)), draw.integers(0, 5, 9), draw.uniform(0.2, 1, 9)

    def loss() -> float:
        return fit._slopes(weights, biases, inputs, kinds, share, draw)[0]

    _, slopes = fit._slopes(weights, biases, inputs, kinds, share, draw)
    for values, slope in zip([*weights, *biases], slopes, strict=True):
        place = np.unravel_index(draw.integers(values.size), values.shape)
        before = values[place]
        values[place] = before + 1e-6
        above = loss()
        values[place] = before - 1e-6
        assert (above - loss()) / 2e-6 == pytest.approx(slope[place], abs=1e-6)
        values[place] = before


@pytest.fixture
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Networks that are fitted in a moment."""
    for name, value in {
        "EPOCHS": 12,
        "NETWORKS": 2,
        "HIDDEN": (16,),
        "BATCH": 64,
        "DROPPED": 0.0,
        "RATE": 0.02,
    }.items():
        monkeypatch.setattr(fit, name, value)


@pytest.mark.usefixtures("_small")
def test_what_shows_is_learned_and_the_same_again() -> None:
    told: list[tuple[int, float]] = []
    network = fitted(examples(1500), 7, lambda done, loss: told.append((done, loss)))
    other = examples(2000, seed=1)
    found = network(other.features)
    assert (found.argmax(1) == other.kinds).mean() > 0.7  # 0.92 at most, and 0.2 by chance
    assert [done for done, _ in told] == list(range(1, 25))
    assert told[5][1] < told[0][1]
    assert fitted(examples(1500), 7, lambda *_: None).to_bytes() == network.to_bytes()
    assert "| car | " in figures(found, other)


@pytest.mark.usefixtures("_small")
def test_a_network_that_is_too_sure_is_calibrated() -> None:
    network, held_out = fitted(examples(1500), 7, lambda *_: None), examples(2000, seed=1)
    sure = replace(network, weights=(*network.weights[:-1], 2.5 * network.weights[-1]))
    before, after = sure(held_out.features), calibrated(sure, held_out)(held_out.features)
    assert log_loss(after, held_out.kinds) < log_loss(before, held_out.kinds) - 0.05


def test_calibration_error() -> None:
    score, is_true = np.array([0.9, 0.9, 0.9, 0.9, 0.2, 0.01]), np.array([1, 1, 1, 0, 0, 1], np.bool_)
    error = calibration_error(score, is_true, np.ones(6))
    assert error == pytest.approx((4 * 0.15 + 0.2) / 5)
    assert calibration_error(score[:0], is_true[:0], np.ones(0)) == 0
