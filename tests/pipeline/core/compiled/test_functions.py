"""Compiled functions: made once, kept, run without a compiler, and made without a place to keep them."""

import importlib.util
import logging
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest

import pipeline.core.compiled.functions as tested
from pipeline.core.compiled import compiling, linking

KERNELS = '''
import numpy as np
from pipeline.core.compiled import compiled, inlined

LARGEST = 3

@inlined
def square(value):
    return value * value

@compiled("float64(float64[::1])")
def squares(values):
    """Their sum."""
    total = 0.0
    for value in values:
        total += square(value)
    return total

@compiled("Tuple((float64, int64[::1]))(float64[::1], int64)")
def both(values, count):
    if count > LARGEST:
        raise ValueError("too many")
    return squares(values), np.full(count, 7)
'''
WORD = "compiling for this processor, once: up to a minute"


@pytest.fixture(autouse=True)
def told_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tested, "_told", False)


def loaded(folder: Path, text: str = KERNELS) -> ModuleType:
    source = folder / "sums.py"
    if not source.exists():
        source.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("sums", source)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def words(caplog: pytest.LogCaptureFixture) -> list[str]:
    said = [record.message for record in caplog.records if record.name == "pipeline.compiled" and record.levelno >= 20]
    caplog.clear()
    return said


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with functions and what is kept of them."""
    folder = tmp_path_factory.mktemp("made")
    loaded(folder)
    return folder


def test_made_once_and_kept(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    assert loaded(tmp_path).squares(np.array([1.0, 2.0])) == 5
    assert words(caplog) == [WORD]
    assert loaded(tmp_path).squares(np.array([3.0])) == 9
    assert words(caplog) == []


def test_another_process_runs_what_is_kept_without_numba(made: Path) -> None:
    program = """
import sys
import numpy as np
from sums import both, squares
total, sevens = both(np.array([1.0, 2.0]), 3)
assert (total, sevens.tolist(), squares(sevens.astype(float))) == (5, [7, 7, 7], 147)
try:
    both(np.zeros(1), 4)
except ValueError as err:
    assert str(err) == "too many"
assert "numba" not in sys.modules
import numba
assert numba.njit(lambda values: values.sum() + 1)(sevens) == 22
assert both(sevens.astype(float), 1)[0] == 147
"""
    path = os.pathsep.join([str(made), *sys.path])
    subprocess.run([sys.executable, "-c", program], check=True, env={**os.environ, "PYTHONPATH": path})


def test_arrays_outlive_the_call(made: Path) -> None:
    module = loaded(made)
    arrays = [module.both(np.ones(5), 3)[1] for _ in range(1000)]
    assert all(array.tolist() == [7, 7, 7] for array in arrays)


def test_a_changed_source_is_compiled_anew(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    before = loaded(tmp_path)
    words(caplog)
    (tmp_path / "sums.py").write_text(KERNELS.replace("value * value", "0 + value + value"), encoding="utf-8")
    assert loaded(tmp_path).squares(np.array([1.0, 2.0])) == 6
    assert before.squares(np.array([1.0, 2.0])) == 5
    assert loaded(tmp_path).both(np.array([3.0]), 1)[0] == 6


@pytest.mark.parametrize("known", [True, False], ids=["linked", "left to numba"])
def test_a_change_in_a_file_that_is_used_is_compiled_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, known: bool
) -> None:
    caplog.set_level(logging.INFO)
    if not known:
        monkeypatch.setattr(tested, "made_for", lambda: None)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python would take that of a file as old and as long
    text = """
from pipeline.core.compiled import compiled
from part_of_sums import FACTOR, times

@compiled("float64(float64)")
def product(value):
    return FACTOR * times(value)
"""

    def product(factor: int, more: int) -> float:
        monkeypatch.delitem(sys.modules, "part_of_sums", raising=False)
        importlib.invalidate_caches()
        part = f"from pipeline.core.compiled import inlined\n\nFACTOR = {factor}\n\n"
        part += f"@inlined\ndef times(value):\n    return value + {more}\n"
        (tmp_path / "part_of_sums.py").write_text(part, encoding="utf-8")
        monkeypatch.setattr(tested, "_told", False)
        result: float = loaded(tmp_path, text).product(1.0)
        return result

    assert (product(2, 3), words(caplog)) == (8, [WORD])
    assert (product(2, 3), words(caplog)) == (8, [])
    assert (product(2, 4), words(caplog)) == (10, [WORD])
    assert (product(3, 4), words(caplog)) == (15, [WORD])


def test_one_that_is_missing_calls_one_that_is_kept(tmp_path: Path) -> None:
    loaded(tmp_path)
    (kept,) = (tmp_path / "__pycache__").glob("sums.both.*.code")
    kept.unlink()
    assert loaded(tmp_path).both(np.array([3.0]), 1)[0] == 9
    assert kept.exists()


def test_a_damaged_file_is_made_anew(tmp_path: Path) -> None:
    loaded(tmp_path)
    for kept in (tmp_path / "__pycache__").glob("*.code"):
        whole = kept.read_bytes()
        kept.write_bytes(whole[:-1] + b"?")
        assert loaded(tmp_path).both(np.array([3.0]), 1)[0] == 9
        assert len(kept.read_bytes()) >= len(whole) - 100


@pytest.mark.parametrize("arguments", [(np.array([1, 2]),), (np.zeros(4)[::2],), (np.zeros((1, 1)),), (1.0,), ()])
def test_other_types_are_refused(made: Path, arguments: tuple[object, ...]) -> None:
    with pytest.raises(TypeError, match=r"squares: expected \(float64 array of 1 dimensions C writable\), got"):
        loaded(made).squares(*arguments)


def test_a_fault_of_the_function_is_raised() -> None:
    with pytest.raises(numba.TypingError):
        tested.compiled("float64(float64)")(lambda value: value.nothing)


def test_works_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert loaded(tmp_path).squares(np.array([1.0, 3.0])) == 10


def test_versions_that_are_not_known_are_left_to_numba(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(tested, "made_for", lambda: None)
    assert loaded(tmp_path).both(np.array([1.0, 2.0]), 1)[0] == 5
    assert words(caplog) == [WORD]
    monkeypatch.setattr(tested, "_told", False)
    second = loaded(tmp_path)
    assert second.both.stats.cache_hits
    assert words(caplog) == []
    with pytest.raises(TypeError, match="No matching definition"):
        second.squares(np.array([1, 2]))


def nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.core.caching.CacheImpl._locator_classes", [])


def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", full)


@pytest.mark.parametrize("fault", [nowhere, full_disk])
def test_numba_works_where_it_can_keep_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: object) -> None:
    assert callable(fault)
    fault(monkeypatch)
    monkeypatch.setattr(tested, "made_for", lambda: None)
    assert loaded(tmp_path).squares(np.array([1.0, 3.0])) == 10


@pytest.mark.parametrize("fault", ["link", "machine_code"])
def test_what_cannot_be_linked_is_left_to_numba(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    def fails(*_: object) -> None:
        raise linking.LinkError if fault == "link" else compiling.UnknownCodeError

    monkeypatch.setattr(tested, fault, fails)
    assert loaded(tmp_path).both(np.array([1.0, 3.0]), 1)[0] == 10


def test_this_version_of_numba_is_known() -> None:
    # Else see that these tests pass with `SEEN` as it has to be then, and the start takes half a second longer.
    assert linking.made_for() is not None


def test_plain_functions_for_a_debugger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert loaded(tmp_path).squares([1, 2, 2]) == 9


def test_no_product_is_fused_with_a_sum() -> None:
    def product(values, factor):  # type: ignore[no-untyped-def]  # numba infers them
        total = 0.0
        for value in values:
            total += value * factor
        return total

    made = compiling.dispatcher(product, "float64(float64[::1], float64)")
    code = "".join(made.inspect_asm().values())
    assert "mul" in code
    assert not any(fused in code for fused in ("vfmadd", "fmadd", "fmla"))
