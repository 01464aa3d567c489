"""Compiled functions: made once, kept, and made without a place to keep them."""

import errno
import importlib.util
import logging
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
import pytest

import pipeline.core.compiled as tested

KERNELS = '''
from pipeline.core.compiled import compiled, inlined

@inlined
def square(value):
    return value * value

@compiled("float64(float64[::1])", "float32(float32[::1])")
def squares(values):
    """Their sum."""
    total = values[0] * 0
    for value in values:
        total += square(value)
    return total
'''


@pytest.fixture(autouse=True)
def told_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tested, "_told", False)


def loaded(folder: Path) -> ModuleType:
    source = folder / "sums.py"
    if not source.exists():
        source.write_text(KERNELS, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("sums", source)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_made_once_and_kept(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    first = loaded(tmp_path)
    assert first.squares(np.array([1.0, 2.0])) == 5
    assert first.squares(np.array([1.0, 1 / 3], np.float32)) == np.float32(1) + np.float32(1 / 3) ** 2
    assert [record.message for record in caplog.records if record.name == "pipeline.compiled"] == [
        "compiling for this processor, once: up to half a minute"
    ]
    caplog.clear()
    second = loaded(tmp_path)
    assert second.squares.stats.cache_hits
    assert second.squares(np.array([3.0])) == 9
    assert not [record for record in caplog.records if record.name == "pipeline.compiled"]


def test_other_types_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="No matching definition"):
        loaded(tmp_path).squares(np.array([1, 2]))


def nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.core.caching.CacheImpl._locator_classes", [])


def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", full)


@pytest.mark.parametrize("fault", [nowhere, full_disk])
def test_works_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Any) -> None:
    fault(monkeypatch)
    assert loaded(tmp_path).squares(np.array([1.0, 3.0])) == 10


def test_a_fault_of_the_function_is_not_taken_for_one_of_the_cache() -> None:
    with pytest.raises(numba.TypingError):
        tested.compiled("float64(float64)")(lambda value: value.nothing)


def test_plain_functions_for_a_debugger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    assert loaded(tmp_path).squares([1, 2, 2]) == 9


def test_no_product_is_fused_with_a_sum(tmp_path: Path) -> None:
    code = "".join(loaded(tmp_path).squares.inspect_asm().values())
    assert "mul" in code
    assert not any(fused in code for fused in ("vfmadd", "fmadd", "fmla"))
