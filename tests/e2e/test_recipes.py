"""The recipes of docs/architecture.md, each followed with something that is thrown away."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from results import fused_objects

SANDBOX = Path(__file__).resolve().parents[2] / "bags" / "sandbox.bag"

ENGINE = '''
import numpy as np

from pipeline.detectors.protocols import Candidates3D


class Toy:
    """Finds one car, always at the same place."""

    def __init__(self, rig, config):
        self.car = config.class_id_of_label["car"]

    def __call__(self, combined):
        center = np.array([[0.5, 1.0, 0.06]])
        size = np.array([[0.3, 0.14, 0.11]])
        one, counts = np.ones(1), np.array([20])
        covariances = np.diag([1e-4, 1e-4, 1e-2])[None]
        return Candidates3D(center, size, 0 * one, 0.9 * one, np.array([self.car]), counts, covariances, 0 * counts)
'''
PROGRAM = """
import sys
from pipeline.core.settings.engines import ENGINES, Engine3D

ENGINES["toy"] = Engine3D("toy_engine:Toy", "by a toy")
ENGINES["big"] = Engine3D("toy_engine:Toy", "by a large toy", package="nowhere_at_all", extra="toys")
sys.argv[0] = "lidcam"
from lidcam.__main__ import main
main()
"""

OUTPUT = '''
import csv


class CsvWriter:
    """One line per object."""

    name = "csv"

    def __init__(self, path, outputs, source, provenance):
        self._part, self._classes = outputs[path].part, source.config.classes

    def __enter__(self):
        self._file = self._part.open("w", newline="", encoding="utf-8")
        self._csv = csv.writer(self._file)
        self._csv.writerow(["# lidcam", "class", "x", "y"])
        return self

    def __exit__(self, kind, error, trace):
        self._file.close()

    def write(self, result):
        boxes = result.fused.objects
        for class_id, (x, y, _) in zip(boxes.class_ids, boxes.centers):
            self._csv.writerow([result.bundle.stamp_ns, self._classes[class_id].name, x, y])
        return ()


def is_own(path):
    return path.read_text().startswith("# lidcam")
'''
OUTPUT_PROGRAM = """
import sys
from lidcam.outputs.kinds import OUTPUTS, OutputKind
from csv_output import CsvWriter, is_own

OUTPUTS[".csv"] = OutputKind(CsvWriter, is_own, "Spreadsheet", lambda path, _: f"open {path.name}")

import lidcam
from lidcam.printing.console import print_report
from lidcam.printing.terminal import console

try:
    done = lidcam.process(sys.argv[1], sys.argv[2:], config="sandbox", duration_s=0.3)
except lidcam.LidcamError as error:
    sys.exit(f"refused: {error}")
print_report(console(), done.report)
"""


def run(folder: Path, program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A program like lidcam's, with the modules of a folder on its path."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def engine(tmp_path: Path) -> Path:
    (tmp_path / "toy_engine.py").write_text(ENGINE, encoding="utf-8")
    return tmp_path


def process(engine: Path, method: str) -> subprocess.CompletedProcess[str]:
    part = ("--duration", "0.3", "--set", "detect2d.method=none", "--set", f"detect3d.method={method}")
    return run(engine, PROGRAM, "process", SANDBOX, engine / "out.mcap", "--config", "sandbox", *part)


def test_an_engine(engine: Path) -> None:
    done = process(engine, "toy")
    assert done.returncode == 0, done.stderr
    assert "3D boxes   by a toy" in done.stdout
    frames = fused_objects(engine / "out.mcap").values()
    assert len(frames) > 1
    for objects in frames:
        assert [(one.label, round(one.x, 1), round(one.y, 1)) for one in objects] == [("car", 0.5, 1.0)]


def test_an_engine_s_name_is_a_setting(engine: Path) -> None:
    done = process(engine, "toys")
    assert done.returncode == 1
    assert "expected one of cluster, recorded, none, toy, big, found 'toys'" in done.stderr


def test_an_engine_says_what_it_needs(engine: Path) -> None:
    done = process(engine, "big")
    assert done.returncode == 1
    assert "needs nowhere_at_all, which is not installed: pip install 'lidcam[toys]'" in done.stderr


def test_an_output(tmp_path: Path) -> None:
    (tmp_path / "csv_output.py").write_text(OUTPUT, encoding="utf-8")
    csv, mcap = tmp_path / "out.csv", tmp_path / "out.mcap"
    done = run(tmp_path, OUTPUT_PROGRAM, SANDBOX, csv, mcap)
    assert done.returncode == 0, done.stderr
    assert "Spreadsheet  open out.csv" in done.stdout
    lines = csv.read_text(encoding="utf-8").splitlines()
    assert len(lines) > 1
    frames = fused_objects(mcap)
    assert len(lines) - 1 == sum(map(len, frames.values()))

    again = run(tmp_path, OUTPUT_PROGRAM, SANDBOX, csv)
    assert again.returncode == 0, "it replaces its own result"
    csv.write_text("mine", encoding="utf-8")
    refused = run(tmp_path, OUTPUT_PROGRAM, SANDBOX, csv)
    assert refused.returncode == 1
    assert "refused: " in refused.stderr
    assert "out.csv: exists and is no result of an earlier run" in refused.stderr
    assert csv.read_text(encoding="utf-8") == "mine"
