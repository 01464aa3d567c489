"""Compiled functions: made once, kept in a folder of the user's own, and made without a place to keep them."""

import ast
import importlib.util
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from lidcam.pipeline.core.compiled import functions
from lidcam.pipeline.core.compiled.functions import cache_folder

KERNELS = '''
import numpy as np
from lidcam.pipeline.core.compiled import compiled, inlined

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
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache."""
    folder = tmp_path / "cache"
    functions._say_so_once.cache_clear()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    cache_folder.cache_clear()
    yield folder
    cache_folder.cache_clear()


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


def hits(module: ModuleType) -> int:
    return sum(module.both.stats.cache_hits.values())


def test_made_once_and_kept(tmp_path: Path, home: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    first = loaded(tmp_path)
    assert (first.squares(np.array([1.0, 2.0])), hits(first)) == (5, 0)
    assert [record.message for record in caplog.records if record.levelno >= logging.INFO] == [WORD]
    (folder,) = home.iterdir()
    assert folder.stat().st_mode & 0o777 == 0o700
    second = loaded(tmp_path)
    assert (second.both(np.array([3.0]), 2)[0], hits(second)) == (9, 1)
    with pytest.raises(ValueError, match="too many"):
        second.both(np.zeros(1), 4)


def test_a_change_of_any_kernel_file_has_a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    assert (before := cache_folder()) is not None
    sources = functions.kernel_sources()
    changed = [(sources[0][0], sources[0][1] + "# changed\n"), *sources[1:]]
    monkeypatch.setattr(functions, "kernel_sources", lambda: changed)
    cache_folder.cache_clear()
    assert cache_folder() not in (before, None)


def writable_by_others(folder: Path) -> None:
    folder.mkdir(parents=True, mode=0o777)
    folder.chmod(0o777)


def a_link(folder: Path) -> None:
    folder.parent.mkdir()
    elsewhere = folder.parent.parent / "elsewhere"
    elsewhere.mkdir()
    folder.symlink_to(elsewhere)


def writable_above(folder: Path) -> None:
    folder.mkdir(parents=True, mode=0o700)
    folder.parent.chmod(0o775)


@pytest.mark.parametrize("planted", [writable_by_others, a_link, writable_above])
def test_a_place_of_others_is_not_used(
    tmp_path: Path, home: Path, caplog: pytest.LogCaptureFixture, planted: Callable[[Path], None]
) -> None:
    folder = cache_folder()
    assert folder is not None
    folder.rmdir()
    home.rmdir()
    planted(folder)
    cache_folder.cache_clear()
    assert cache_folder() is None
    assert loaded(tmp_path).squares(np.array([1.0, 3.0])) == 10
    warnings = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert len(warnings) == 1
    assert "compiled for this run alone" in warnings[0]
    assert not list((tmp_path / "elsewhere").glob("*"))


def test_the_folder_is_the_users_alone_whatever_the_umask(tmp_path: Path, home: Path) -> None:
    before = os.umask(0)
    try:
        loaded(tmp_path)
    finally:
        os.umask(before)
    assert [path.stat().st_mode & 0o777 for path in (home, *home.iterdir())] == [0o700, 0o700]
    cache_folder.cache_clear()
    assert hits(loaded(tmp_path)) == 1


def test_a_file_that_was_cut_short_is_made_anew(tmp_path: Path, home: Path) -> None:
    loaded(tmp_path)
    for path in home.rglob("*.nbc"):
        path.write_bytes(b"")
    assert loaded(tmp_path).squares(np.array([1.0, 3.0])) == 10
    loaded(tmp_path)
    assert hits(loaded(tmp_path)) == 1


def test_works_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", full)
    assert loaded(tmp_path).squares(np.array([1.0, 3.0])) == 10


def test_plain_functions_for_a_debugger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.config.DISABLE_JIT", True)
    assert loaded(tmp_path).squares([1, 2, 2]) == 9


def test_settings_of_numba_in_the_current_folder_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / ".numba_config.yaml").write_bytes(b"{broken: [")
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-P", "-c", "import lidcam.pipeline.core.compiled"]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert f"ConfigError: {tmp_path}/.numba_config.yaml: expected settings of numba, found " in done.stderr


def test_no_product_is_fused_with_a_sum() -> None:
    @functions.compiled("float64(float64[::1], float64)")
    def product(values, factor):  # type: ignore[no-untyped-def]  # numba infers them
        total = 0.0
        for value in values:
            total += value * factor
        return total

    made: Any = product
    code = "".join(made.inspect_asm().values())
    assert "mul" in code
    assert not any(fused in code for fused in ("vfmadd", "fmadd", "fmla"))


def test_compiled_functions_use_numbers_and_functions_of_kernel_files_alone() -> None:
    """What a compiled function takes from another file would not be in the key of what is kept."""
    texts = dict(functions.kernel_sources())
    known = {".".join(path.relative_to(functions._ROOT).with_suffix("").parts) for path in texts}
    known |= {"lidcam.pipeline.core.arrays", "lidcam.pipeline.core.compiled"}
    assert len(known) > 5
    for path, text in texts.items():
        tree = ast.parse(text)
        others = {
            alias.asname or alias.name
            for node in tree.body
            if isinstance(node, ast.ImportFrom)
            and str(node.module).startswith("lidcam.pipeline.")
            and node.module not in known
            for alias in node.names
        }
        for function in (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.decorator_list):
            if any(ast.unparse(one).startswith(("compiled", "inlined")) for one in function.decorator_list):
                used = {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
                assert not used & others, f"{path}: {function.name}"
