"""An installation without packages that most commands do without: others say in one line what is missing."""

from pathlib import Path

import pytest
from command import Run, called_apart
from helpers import SANDBOX

WITHOUT = """
import sys


class Gone:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in gone:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Gone())
import importlib.util

found = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name in gone else found(name, package)
"""


def test_a_small_installation_processes_and_exports(tmp_path: Path) -> None:
    part = ("--duration", 0.2, "--set", "detect3d.method=cluster")
    done = called_apart(
        tmp_path,
        "gone = {'rerun', 'pyarrow', 'scipy', 'jinja2'}" + WITHOUT,
        ("inspect", SANDBOX),
        ("process", SANDBOX, *part, "--out", "drive"),
        ("process", SANDBOX, "out.mcap", *part, "--objects", "out.csv", "--save-matches", "images"),
        ("export", "out.mcap", "--format", "coco", "--out", "set"),
        ("compare", "out.mcap", "out.mcap"),
    )
    assert [one.code for one in done] == [0] * 5, done
    assert {one.suffix for one in (tmp_path / "drive").iterdir()} == {".mcap", ".json"}


@pytest.mark.slow
def test_a_small_installation_shows_the_demo(tmp_path: Path) -> None:
    (demo,) = called_apart(tmp_path, "gone = {'rerun', 'pyarrow'}" + WITHOUT, ("demo", "demo"))
    assert demo.code == 0, demo.err
    assert "lidcam view demo/sandbox.html (or .mcap)" in demo.out
    assert not list((tmp_path / "demo").glob("*.rrd"))


COMMANDS = [
    ("rerun-sdk", "process IN out.mcap --rerun out.rrd"),
    ("rerun-sdk", "process IN out.mcap --view"),
    ("pyarrow", "process IN out.mcap --objects out.parquet"),
    ("pyarrow", "batch IN --out results"),
    ("jinja2", "process IN out.mcap --report out.html"),
]


@pytest.fixture(scope="module")
def refused(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Run], Path]:
    folder = tmp_path_factory.mktemp("refused")
    commands = [tuple(str(SANDBOX) if word == "IN" else word for word in line.split()) for _, line in COMMANDS]
    return called_apart(folder, "gone = {'rerun', 'pyarrow', 'jinja2'}" + WITHOUT, *commands), folder


@pytest.mark.slow
@pytest.mark.parametrize("row", range(len(COMMANDS)), ids=[line for _, line in COMMANDS])
def test_what_needs_a_package_says_so_in_one_line(refused: tuple[list[Run], Path], row: int) -> None:
    (package, _), (runs, folder) = COMMANDS[row], refused
    said = f"lidcam: error: this needs {package}, which is not installed: pip install {package}\n"
    assert (runs[row].code, runs[row].err) == (1, said)
    assert not [path for path in folder.iterdir() if path.suffix]
