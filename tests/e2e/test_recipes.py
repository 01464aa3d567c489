"""The recipes of docs/architecture.md, each followed with something that is thrown away.

What a recipe puts into a row of a table is put there by a program that then does what lidcam does.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from builders import write_mcap
from message_layouts import message_of_layout
from results import fused_objects, messages_of
from small_drive import small_drive

from pipeline.core.messages import RawMessage
from readers.messages.pointcloud2 import decode_pointcloud2

SANDBOX = Path(__file__).resolve().parents[2] / "bags" / "sandbox.bag"

COMMAND = """
import sys
from lidcam.__main__ import main

sys.argv[0] = "lidcam"
main()
"""


def run(folder: Path, module: str, program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A program like lidcam's, with the module `toy` on its path."""
    (folder / "toy.py").write_text(module, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


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
ENGINE_ROWS = """
from pipeline.core.settings.engines import ENGINES, Engine3D

ENGINES["toy"] = Engine3D("toy:Toy", "by a toy")
ENGINES["big"] = Engine3D("toy:Toy", "by a large toy", package="nowhere_at_all", extra="toys")
"""


@pytest.mark.parametrize(
    ("method", "told"),
    [
        ("toy", ""),
        ("toys", "expected one of cluster, recorded, none, toy, big, found 'toys'"),
        ("big", "needs nowhere_at_all, which is not installed: pip install 'lidcam[toys]'"),
    ],
)
def test_an_engine(method: str, told: str, tmp_path: Path) -> None:
    part = ("--duration", "0.3", "--set", "detect2d.method=none", "--set", f"detect3d.method={method}")
    out, program = tmp_path / "out.mcap", ENGINE_ROWS + COMMAND
    done = run(tmp_path, ENGINE, program, "process", SANDBOX, out, "--config", "sandbox", *part)
    assert done.returncode == bool(told), done.stderr
    if told:
        assert told in done.stderr
        return
    assert "3D boxes   by a toy" in done.stdout
    frames = fused_objects(out).values()
    assert len(frames) > 1
    for objects in frames:
        assert [(one.label, round(one.x, 1), round(one.y, 1)) for one in objects] == [("car", 0.5, 1.0)]


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
from toy import CsvWriter, is_own

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


def test_an_output(tmp_path: Path) -> None:
    csv, mcap = tmp_path / "out.csv", tmp_path / "out.mcap"
    done = run(tmp_path, OUTPUT, OUTPUT_PROGRAM, SANDBOX, csv, mcap)
    assert done.returncode == 0, done.stderr
    assert "Spreadsheet  open out.csv" in done.stdout
    lines = csv.read_text(encoding="utf-8").splitlines()
    assert len(lines) - 1 == sum(map(len, fused_objects(mcap).values())) > 0

    again = run(tmp_path, OUTPUT, OUTPUT_PROGRAM, SANDBOX, csv)
    assert again.returncode == 0, "it replaces its own result"
    csv.write_text("mine", encoding="utf-8")
    refused = run(tmp_path, OUTPUT, OUTPUT_PROGRAM, SANDBOX, csv)
    assert (refused.returncode, refused.stderr.startswith("refused: ")) == (1, True)
    assert "out.csv: exists and is no result of an earlier run" in refused.stderr
    assert csv.read_text(encoding="utf-8") == "mine"


SPHERES = "toy_msgs/msg/Spheres"
DECODER = '''
import numpy as np

from pipeline.core.clouds import PointCloud
from pipeline.core.settings.recording import DEFAULT_LIMITS
from readers.messages.boundary.decoding import decoder
from readers.messages.deserialize import deserialize

@decoder
def decode_spheres(message, *, limits=DEFAULT_LIMITS, others=0):
    """The centre of each sphere, its radius as intensity."""
    read = deserialize(message, limits=limits)
    rows = np.array([(s.center.x, s.center.y, s.center.z, s.radius) for s in read.spheres], np.float32).reshape(-1, 4)
    none = np.zeros(len(rows), np.uint16), np.zeros(len(rows), np.int32)
    return PointCloud(message.stamp_ns, read.header.frame_id, rows[:, :3].copy(), rows[:, 3].copy(), *none)
'''
MESSAGE_ROW = """
from readers.messages.registry import TYPES, MessageType

TYPES["toy_msgs/msg/Spheres"] = MessageType("cloud", "toy:decode_spheres")
"""


def as_spheres(message: RawMessage, radius: str) -> RawMessage:
    """A cloud as a message of the type that is thrown away."""
    cloud = decode_pointcloud2(message)
    definitions = {
        "toy_msgs/msg/Sphere": f"geometry_msgs/Point32 center\nfloat32 {radius}",
        SPHERES: "std_msgs/Header header\nSphere[] spheres",
    }
    spheres = [
        {"center": dict(zip("xyz", xyz, strict=True)), radius: strength}
        for xyz, strength in zip(cloud.xyz.tolist(), cloud.intensity.tolist(), strict=True)
    ]
    stamp = {"sec": message.stamp_ns // 10**9, "nanosec": message.stamp_ns % 10**9}
    body = {"header": {"stamp": stamp, "frame_id": cloud.frame_id}, "spheres": spheres}
    made = message_of_layout(SPHERES, definitions, "cdr", body, topic=message.topic, stamp_ns=message.stamp_ns)
    return made._replace(log_time_ns=message.log_time_ns)


@pytest.mark.parametrize(
    ("radius", "told"), [("radius", ""), ("size", "/points: 12 messages dropped: cannot be decoded")]
)
def test_a_message_type(radius: str, told: str, tmp_path: Path) -> None:
    drive = small_drive("cdr", motion="none", kinds=("boxes",))
    write_mcap(tmp_path / "in.mcap", [as_spheres(one, radius) if one.topic == "/points" else one for one in drive])
    done = run(tmp_path, DECODER, MESSAGE_ROW + COMMAND, "process", "in.mcap", "out.mcap", "--workers", "1")
    assert done.returncode == (3 if told else 0), done.stderr
    if told:
        assert told in done.stderr
        return
    clouds = messages_of(tmp_path / "out.mcap", "/point_cloud_combined")
    assert len(clouds) > 5
    for _, cloud in clouds:
        points = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_step)[:, :16].copy().view(np.float32)
        assert len(points) > 50
        np.testing.assert_allclose(points[:, 0], points[:, 3], atol=1e-5)  # x was recorded as the intensity
