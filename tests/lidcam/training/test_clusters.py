"""Examples, networks fitted to them, and their figures."""

# without torch the file is skipped before it imports what needs it

from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("torch", reason="needs the extra train")

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.training import clusters
from lidcam.training.card import figures, log_loss
from lidcam.training.clusters import calibrated, fitted
from lidcam.training.examples import Examples, examples_of, kinds_of_boxes


def examples(count: int, seed: int = 0) -> Examples:
    """Boxes whose kind shows in three features; one in ten is called by another kind."""
    draw = np.random.default_rng(seed)
    kinds: I64 = draw.integers(0, 5, count)
    features = draw.normal(size=(count, len(FEATURES)))
    features[:, :3] += 3 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])[kinds]
    return Examples(features, np.where(draw.random(count) < 0.1, draw.integers(0, 5, count), kinds))


@pytest.mark.slow
def test_several_lidars_on_masts_see_all_kinds_in_two_worlds() -> None:
    """Takes two seconds: worlds are built and cast."""
    worlds = list(examples_of("crossing", range(2), workers=1))
    kinds = np.bincount(np.concatenate([world.kinds for world in worlds]), minlength=5)
    assert kinds[0] > kinds[1:].max()
    assert (kinds > 0).all()
    for features, kinds_of_world in worlds:
        assert features.shape == (len(kinds_of_world), len(FEATURES))
        assert np.isfinite(features).all()


def test_a_box_is_what_stands_nearest_within_its_gate() -> None:
    truth, kinds = np.array([[10.0, 0.0], [10.0, 1.5], [30.0, 0.0]]), np.array([1, 2, 4])
    boxes = np.array([[10.5, 0.0], [10.0, 1.2], [12.5, 0.0], [32.4, 0.0], [10.0, 2.2]])
    assert kinds_of_boxes(boxes, truth, kinds).tolist() == [1, 2, 0, 4, 0]
    assert kinds_of_boxes(boxes, truth[:0], kinds[:0]).tolist() == [0] * 5
    assert kinds_of_boxes(boxes[:0], truth, kinds).shape == (0,)


@pytest.mark.slow
def test_what_shows_is_learned_the_same_again_and_calibrated(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {
        "EPOCHS": 12,
        "NETWORKS": 2,
        "HIDDEN": (16,),
        "BATCH": 64,
        "DROPOUT": 0.0,
        "RATE": 0.02,
    }.items():
        monkeypatch.setattr(clusters, name, value)
    losses, threads = list[tuple[int, float]](), torch.get_num_threads()
    network = fitted(examples(1500), 7, lambda done, loss: losses.append((done, loss)))
    assert torch.get_num_threads() == threads
    held_out = examples(2000, seed=1)
    found = network(held_out.features)
    assert (found.argmax(1) == held_out.kinds).mean() > 0.7  # 0.92 at most, and 0.2 by chance
    assert [done for done, _ in losses] == list(range(1, 25))
    assert losses[5][1] < losses[0][1]
    assert fitted(examples(1500), 7, lambda *_: None).to_bytes() == network.to_bytes()
    assert "| car | " in figures(found, held_out)

    sure = replace(network, weights=(*network.weights[:-1], 2.5 * network.weights[-1]))
    before, after = sure(held_out.features), calibrated(sure, held_out)(held_out.features)
    assert log_loss(after, held_out.kinds) < log_loss(before, held_out.kinds) - 0.05
