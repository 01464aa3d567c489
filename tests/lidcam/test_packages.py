"""Folders of other projects that have the names of lidcam's packages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


def started(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(
        [sys.executable, *command], cwd=folder.parent, env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture(params=["pipeline/__init__.py", "readers.py", "bags/__init__.py"])
def foreign(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "other" / str(request.param)
    path.parent.mkdir(parents=True)
    path.write_text("", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "command",
    [
        ("-c", "import lidcam; lidcam.process('x.bag')"),
        ("-c", "from lidcam.run import process_recording"),
        ("-m", "lidcam", "inspect", "x.bag"),
        ("-c", "from lidcam.__main__ import main_process; main_process()"),
    ],
)
def test_the_error_names_the_folder(foreign: Path, command: tuple[str, ...]) -> None:
    folder = foreign.parent if foreign.parent.name == "other" else foreign.parent.parent
    done = started(folder, *command)
    assert done.returncode == 1
    assert done.stdout == ""
    line = done.stderr.splitlines()[-1]
    assert line.startswith("ImportError: lidcam: expected its package")
    assert str(foreign.parent if foreign.name == "__init__.py" else foreign) in line
    assert "PYTHONPATH" in line


def test_a_folder_without_a_package_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "other" / "pipeline").mkdir(parents=True)
    done = started(tmp_path / "other", "-c", "import lidcam; print(lidcam.load_config().sync.policy)")
    assert (done.returncode, done.stdout) == (0, "approximate_time\n"), done.stderr
