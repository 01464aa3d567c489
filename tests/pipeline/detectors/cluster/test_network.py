"""Files of weights, and what a network makes of features."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.pipeline.detectors.cluster.network import EMBEDDED, ClusterNetwork

DRAW = np.random.default_rng(0)
WIDTH = len(FEATURES)
SMALL = ClusterNetwork(
    DRAW.normal(size=WIDTH),
    DRAW.uniform(0.5, 2, WIDTH),
    (DRAW.normal(size=(2, WIDTH, 6)), DRAW.normal(size=(2, 6, 5))),
    (DRAW.normal(size=(2, 1, 6)), DRAW.normal(size=(2, 1, 5))),
)


def test_a_network_is_the_mean_of_its_parts_and_a_file_holds_it(tmp_path: Path) -> None:
    features = DRAW.normal(0, 3, (7, WIDTH))
    expected = np.zeros((7, 5))
    for row, values in enumerate((features - SMALL.mean) / SMALL.deviation):
        for part in range(2):
            hidden = np.maximum(values.clip(-4, 4) @ SMALL.weights[0][part] + SMALL.biases[0][part, 0], 0)
            odds = np.exp(hidden @ SMALL.weights[1][part] + SMALL.biases[1][part, 0])
            expected[row] += odds / odds.sum() / 2
    np.testing.assert_allclose(SMALL(features), expected, rtol=1e-9)
    assert SMALL(features[:0]).shape == (0, 5)
    path = tmp_path / "small.npz"
    path.write_bytes(SMALL.to_bytes())
    assert ClusterNetwork.read(path).to_bytes() == SMALL.to_bytes()
    np.testing.assert_allclose(ClusterNetwork.read(path)(features), expected, rtol=1e-4, atol=1e-6)


def test_the_embedded_weights_are_small_and_whole() -> None:
    assert EMBEDDED.stat().st_size < 300_000
    assert EMBEDDED.with_suffix(".md").is_file()
    assert ClusterNetwork.read(EMBEDDED)(np.zeros((3, WIDTH))).shape == (3, len(KINDS))


NAMED = {"features": np.array(FEATURES), "kinds": np.array(KINDS)}
MISFIT = {
    "mean": np.zeros(WIDTH),
    "deviation": np.ones(WIDTH),
    "weights0": np.ones((1, 3, 5)),
    "biases0": np.ones((1, 1, 5)),
}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "expected weights"),
        (b"PK\x03\x04 cut short", "expected weights"),
        (None, "cannot be read"),
        ({}, "other features"),
        (NAMED | {"features": np.array(["range"])}, "other features"),
        (NAMED, "other shapes|do not fit"),
        (NAMED | MISFIT, "do not fit"),
        (NAMED | MISFIT | {"weights0": np.full((1, WIDTH, 5), np.nan)}, "not finite"),
        (NAMED | MISFIT | {"weights0": np.ones((1, WIDTH, 5)), "mean": np.full(WIDTH, np.inf)}, "not finite"),
        ({"features": np.array([None], dtype=object)}, "pickle"),
    ],
    ids=["empty", "cut", "missing", "nothing", "features", "no layers", "shapes", "NaN", "infinite", "pickle"],
)
def test_other_files_are_refused(tmp_path: Path, content: Any, message: str) -> None:
    path = tmp_path / "other.npz"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.savez(path, **content)
    with pytest.raises(ModelError, match=rf"other\.npz: .*({message})"):
        ClusterNetwork.read(path)
