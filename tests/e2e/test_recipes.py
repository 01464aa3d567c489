"""The recipes of docs/architecture.md, each followed with something that is thrown away.

What a recipe puts into a row of a table is put there by a program that then does what lidcam does.
"""

from pathlib import Path

import numpy as np
import pytest
from builders import write_mcap
from command import called_apart
from helpers import CLUSTERS, SANDBOX
from message_layouts import message_of_layout
from results import fused_objects, messages_of
from small_drive import small_drive
from summaries import printed

import lidcam
from lidcam.outputs.registry import OUTPUTS, Output
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2

ENGINE = '''
import numpy as np

from lidcam.pipeline.detectors.protocols import Candidates3D


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
from lidcam.pipeline.core.settings.engines import ENGINES, Engine3D

ENGINES["toy"] = Engine3D("toy:Toy", "toy boxes")
"""


def test_an_engine(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    part = ("--config", "sandbox", "--duration", "0.3", "--set", "detect2d.method=none", "--set")
    commands = [("process", SANDBOX, out, *part, f"detect3d.method={name}") for name in ("toy", "toys")]
    (tmp_path / "toy.py").write_text(ENGINE, encoding="utf-8")
    done, unknown = called_apart(tmp_path, ENGINE_ROWS, *commands)
    assert "'none' or 'toy', found 'toys'" in unknown.error_line
    assert "3D boxes: toy boxes;" in done.out
    frames = fused_objects(out).values()
    assert len(frames) > 1
    for objects in frames:
        assert [(one.label, round(one.x, 1), round(one.y, 1)) for one in objects] == [("car", 0.5, 1.0)]


OUTPUT = '''
import csv


from lidcam.writers.base import ResultWriter


class ToyWriter(ResultWriter):
    """One line per object."""

    name = "toy"

    def __init__(self, opening):
        self._part, self._classes = opening.file.part, opening.source.config.classes

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


def test_an_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "toy.py").write_text(OUTPUT, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    row = Output("Spreadsheet", "", ".toy", "toy:ToyWriter", is_own="toy:is_own", how_to_open="open {path.name}")
    monkeypatch.setattr("lidcam.outputs.registry.OUTPUTS", [*OUTPUTS, row])
    table, mcap = tmp_path / "out.toy", tmp_path / "out.mcap"
    for outputs in ([table, mcap], table):  # the second time, it replaces its own result
        done = lidcam.process(SANDBOX, outputs, config="sandbox", settings=[CLUSTERS], duration_s=0.3)
        assert "Spreadsheet  open out.toy" in printed(done.summary)
        lines = table.read_text(encoding="utf-8").splitlines()
        assert len(lines) - 1 == sum(map(len, fused_objects(mcap).values())) > 0
    table.write_text("mine", encoding="utf-8")
    with pytest.raises(lidcam.OutputError, match=r"out\.toy: exists and was not written by lidcam"):
        lidcam.process(SANDBOX, table, config="sandbox", duration_s=0.3)
    assert table.read_text(encoding="utf-8") == "mine"


SPHERES = "toy_msgs/msg/Spheres"
DECODER = '''
import numpy as np

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize

@decoder
def decode_spheres(message, *, limits=DEFAULT_LIMITS, others=0):
    """The centre of each sphere, its radius as intensity."""
    read = deserialize(message, limits=limits)
    rows = np.array([(s.center.x, s.center.y, s.center.z, s.radius) for s in read.spheres], np.float32).reshape(-1, 4)
    none = np.zeros(len(rows), np.uint16), np.zeros(len(rows), np.int32)
    return PointCloud(message.stamp_ns, read.header.frame_id, rows[:, :3].copy(), rows[:, 3].copy(), *none)
'''
MESSAGE_ROW = """
from lidcam.readers.messages.registry import TYPES, MessageType

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


def test_a_message_type(tmp_path: Path) -> None:
    drive = small_drive("cdr", motion="none", kinds=("boxes",))
    for name in ("radius", "size"):  # the second is none that the decoder knows
        messages = [as_spheres(one, name) if one.topic == "/points" else one for one in drive]
        write_mcap(tmp_path / f"{name}.mcap", messages)
    options = ("--workers", "1", "--set", CLUSTERS)
    commands = [("process", f"{name}.mcap", f"{name}.out.mcap", *options) for name in ("radius", "size")]
    (tmp_path / "toy.py").write_text(DECODER, encoding="utf-8")
    done, other = called_apart(tmp_path, MESSAGE_ROW, *commands)
    assert (done.code, other.code) == (0, 3), done.err
    assert "/points: 12 messages dropped: cannot be decoded" in other.err
    clouds = messages_of(tmp_path / "radius.out.mcap", "/point_cloud_combined")
    assert len(clouds) > 5
    for _, cloud in clouds:
        points = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_step)[:, :16].copy().view(np.float32)
        assert len(points) > 50
        more = points[:, 3] - points[:, 0]  # x and a number of the cloud were recorded as the intensity
        np.testing.assert_allclose(more, more[0], atol=1e-5)
