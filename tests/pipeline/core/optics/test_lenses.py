import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from lens_models import LENS_MODELS, lens

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.optics.lenses import Lenses

ALL = [lens(model, distortion) for model, distortion in LENS_MODELS.values()]
points = arrays(np.float64, (3, 3), elements=st.floats(-1, 1)).map(lambda p: p * [4, 3, 2] + [0, 0, 4])


def rows_of(lenses: Lenses, table: F64) -> F64:
    """The same points for every lens."""
    return np.broadcast_to(table, (len(lenses.K), *table.shape)).copy()


@given(points)
def test_pixels_are_those_of_each_camera(table: F64) -> None:
    lenses = Lenses.of(ALL)
    pixels, valid = lenses.project(rows_of(lenses, table))
    for row, model in enumerate(ALL):
        expected, inside = model.project(table)
        np.testing.assert_array_equal(valid[row], inside)
        np.testing.assert_allclose(pixels[row][inside], expected[inside], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize(("name", "bends"), [(name, name != "none") for name in LENS_MODELS])
def test_which_lenses_bend_lines(name: str, bends: bool) -> None:
    lenses = Lenses.of([lens(*LENS_MODELS["none"]), lens(*LENS_MODELS[name])])
    assert lenses.bends is bends
    assert not lenses.select(np.array([0, 0])).bends


def test_no_cameras() -> None:
    lenses = Lenses.of([])
    pixels, valid = lenses.project(np.zeros((0, 8, 3)))
    assert (pixels.shape, valid.shape) == ((0, 8, 2), (0, 8))
    assert not lenses.bends
