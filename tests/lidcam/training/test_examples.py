"""Examples of drawn worlds."""

import numpy as np

from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.training.examples import examples_of_worlds


def test_several_lidars_on_masts_see_all_kinds_in_two_worlds() -> None:
    """Takes two seconds: worlds are built and cast."""
    worlds = list(examples_of_worlds("crossing", range(2), workers=1))
    assert len(worlds) == 2
    kinds = np.bincount(np.concatenate([world.kinds for world in worlds]), minlength=5)
    assert kinds[0] > kinds[1:].max()
    assert (kinds > 0).all()
    for features, kinds_of_world in worlds:
        assert features.shape == (len(kinds_of_world), len(FEATURES))
        assert np.isfinite(features).all()
