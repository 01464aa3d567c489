"""The search for neighbours: its vectors, and the same code without a compiler. What it finds: test_outliers.py."""

import importlib.util
from types import ModuleType

import numpy as np
import pytest

from pipeline.core.compiled.lanes import LANES
from pipeline.filters import neighbor_search
from pipeline.filters.box_tree import RUN, box_tree, curve_order


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module as it is for a debugger: functions of arrays in place of instructions."""
    monkeypatch.setattr("numba.config.DISABLE_JIT", True)
    spec = importlib.util.spec_from_file_location("plain_search", neighbor_search.__file__)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("count", "neighbors"), [(17, 1), (40, 3), (70, 20)])
@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_without_a_compiler_it_finds_the_same(plain: ModuleType, count: int, neighbors: int) -> None:
    xyz = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)
    order = curve_order(xyz)
    tree = box_tree(xyz, order)
    expected = plain.mean_distances(*tree, order, neighbors)
    np.testing.assert_array_equal(neighbor_search.mean_distances(*tree, order, neighbors), expected)


def test_a_run_fills_a_vector() -> None:
    assert RUN == LANES
