"""Other processes compile what this one has not come to yet, and end with the block."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.core.compiled import beside

ONE = """
from pipeline.core.compiled import compiled

@compiled("int64(int64)")
def {name}(value):
    return value + 1
"""
PROGRAM = """
import sys, time
from pathlib import Path
from pipeline.core.compiled import beside, compiled_beside

beside.kernel_modules = lambda: ["first", "last"]
with compiled_beside(int(sys.argv[1])):
    import first
    running = list(beside._running)
    until = time.monotonic() + 60 * bool(running)
    while not {*Path("__pycache__").glob("last.*.code")} and time.monotonic() < until:
        time.sleep(0.01)
    kept = len({*Path("__pycache__").glob("last.*.code")})
import last
print(len(running), kept, first.first(1), last.last(2), [one.returncode is None for one in running])
"""


def test_all_modules_with_compiled_functions_are_known() -> None:
    modules = beside.kernel_modules()
    assert modules == sorted(modules)
    assert {"pipeline.filters.neighbor_search", "pipeline.detectors.cluster.grid_kernels"} < {*modules}
    assert not [name for name in modules if name.startswith("pipeline.core.compiled")]


@pytest.mark.parametrize(
    ("processes", "expected"), [(1, "0 0 2 3 []"), (2, "1 1 2 3 [False]"), (3, "2 1 2 3 [False, False]")]
)
def test_they_compile_from_the_last_and_end(tmp_path: Path, processes: int, expected: str) -> None:
    for name in ("first", "last"):
        (tmp_path / f"{name}.py").write_text(ONE.format(name=name), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-P", "-c", PROGRAM, str(processes)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    assert done.stdout.strip() == expected
    again = subprocess.run(command, cwd=tmp_path, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    assert again.stdout.strip() == "0 1 2 3 []"  # all is kept: nothing is started


def test_one_that_is_not_done_ends_with_the_block(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text("import time\ntime.sleep(600)\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(beside, "kernel_modules", lambda: ["slow"])
    started = time.monotonic()
    with beside.compiled_beside(2):
        beside.start_others()
        (process,) = beside._running
        beside.start_others()
        assert len(beside._running) == 1
    assert process.returncode == 0
    assert time.monotonic() - started < 60
    beside.start_others()
    assert not beside._running


def test_where_none_can_be_started_this_one_does_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with beside.compiled_beside(3):
        beside.start_others()
        assert not beside._running
