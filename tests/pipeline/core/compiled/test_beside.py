"""Other processes compile what this one has not come to yet, and end with the block."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lidcam.pipeline.core.compiled import beside

ONE = """
from lidcam.pipeline.core.compiled import compiled

@compiled("int64(int64)")
def {name}(value):
    return value + 1
"""
PROGRAM = """
import sys, time
from pathlib import Path
from lidcam.pipeline.core.compiled import beside, compiled_beside, functions

folder, told = functions.cache_folder(), []
sources = [(beside._ROOT / name, "\\n@compiled(") for name in ("first.py", "last.py")]
beside.kernel_sources = lambda: sources
with compiled_beside(int(sys.argv[1]), lambda done, total: told.append((done, total))):
    import first
    running = list(beside._first_run.running)
    while running and not list(folder.rglob("last.last-*.nbi")):
        time.sleep(0.01)  # the test ends this process if it never comes
    kept = len(list(folder.rglob("last.last-*.nbi")))
import last
print(len(running), kept, first.first(1), last.last(2), [one.returncode for one in running], told)
"""


def test_all_modules_with_compiled_functions_are_known() -> None:
    paths = [path for path, _ in beside.kernel_sources()]
    assert paths == sorted(paths)
    assert {"neighbor_search.py", "relief.py"} < {path.name for path in paths}
    assert not [path for path in paths if path.parent.name == "compiled"]


def test_they_compile_from_the_last_and_end(tmp_path: Path) -> None:
    for name in ("first", "last"):
        (tmp_path / f"{name}.py").write_text(ONE.format(name=name), encoding="utf-8")
    places = {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-P", "-c", PROGRAM, "3"]
    for told in ("2 1 2 3 [0, 0] [(1, 2)]", "0 1 2 3 [] []"):  # the second time, all is kept: nothing is started
        done = subprocess.check_output(command, cwd=tmp_path, env=os.environ | places, text=True)
        assert done.strip() == told


def test_one_that_is_not_done_ends_with_the_block(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text("import time\ntime.sleep(600)\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(beside, "kernel_sources", lambda: [(beside._ROOT / "slow.py", "")])
    with beside.compiled_beside(2):
        beside.one_compiled(tmp_path)
        (process,) = beside._first_run.running
        beside.one_compiled(tmp_path)
        assert len(beside._first_run.running) == 1
    assert process.returncode == 0
    beside.one_compiled(tmp_path)
    assert not beside._first_run.running
