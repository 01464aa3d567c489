"""An installation without packages that most commands do without: others say in one line what is missing."""

import subprocess
import sys
from pathlib import Path

import pytest

WITHOUT = """
import sys

gone = set(sys.argv.pop(1).split(","))


class Gone:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in gone:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Gone())
import importlib.util

found = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name in gone else found(name, package)
from lidcam.__main__ import main

main()
"""
ALL = "rerun,pyarrow,scipy,jinja2"


def called(gone: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, gone, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_small_installation_processes_and_exports(sandbox: Path, tmp_path: Path) -> None:
    result = tmp_path / "out.mcap"
    part = ("--duration", 0.2, "--set", "detect3d.method=cluster")
    for arguments in (
        ("inspect", sandbox),
        ("process", sandbox, result, *part, "--objects", tmp_path / "out.csv", "--save-matches", tmp_path / "images"),
        ("export", result, "--format", "coco", "--out", tmp_path / "set"),
        ("compare", result, result),
    ):
        done = called(ALL, *arguments)
        assert done.returncode == 0, done.stderr


def test_the_demo_does_without_rerun(tmp_path: Path) -> None:
    done = called("rerun,pyarrow", "demo", tmp_path / "demo")
    assert done.returncode == 0, done.stderr
    assert "open sandbox.mcap in Foxglove" in done.stdout
    assert not list((tmp_path / "demo").glob("*.rrd"))


@pytest.mark.parametrize(
    ("gone", "arguments", "package"),
    [
        ("rerun", ["process", "IN", "out.mcap", "--rerun", "out.rrd"], "rerun-sdk"),
        ("rerun", ["process", "IN", "out.mcap", "--view"], "rerun-sdk"),
        ("pyarrow", ["process", "IN", "out.mcap", "--objects", "out.parquet"], "pyarrow"),
        ("pyarrow", ["batch", "IN", "--out", "results"], "pyarrow"),
        ("jinja2", ["process", "IN", "out.mcap", "--duration", "0.2", "--report", "out.html"], "jinja2"),
    ],
)
def test_what_needs_a_package_says_so_in_one_line(
    sandbox: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gone: str, arguments: list[str], package: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = called(gone, *(str(sandbox) if word == "IN" else word for word in arguments))
    assert done.returncode == 1
    assert done.stderr == f"lidcam: error: this needs {package}, which is not installed: pip install {package}\n"
    assert not [path for path in tmp_path.iterdir() if path.suffix]
