"""A camera that is turned by two degrees against its calibration: it is named, and fusion stays better than lidars."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml

import lidcam
from lidcam.evaluation.frames import EvaluationFrames
from pipeline.core.arrays import F64
from pipeline.evaluation.evaluation_frame import EvaluationFrame
from readers.results.result import open_result
from readers.rig.rig_file import rig_yaml
from readers.rig.schema import RigFile, parse_rig
from readers.truth.open import open_truth

BAGS = Path(__file__).resolve().parents[2] / "bags"
TURN_RAD = np.radians(2.0)
WRITTEN = {"output.images": False, "output.clouds": False, "run.workers": 1}


@dataclass(frozen=True)
class Measured:
    """A result against the truth.

    Attributes:
        f1: Harmonic mean of recall and precision of all classes, by source.
        lidar_m: Errors of the positions that the lidars alone give to objects that fusion finds, too.
        fused_m: Those of the same objects after fusion.
    """

    f1: dict[str, float]
    lidar_m: F64
    fused_m: F64


def turned(rig: lidcam.Rig, name: str) -> RigFile:
    """The rig with a camera turned about its own vertical axis."""
    file = parse_rig(yaml.safe_load(rig_yaml(rig)), Path("rig.yaml"))
    cos, sin = np.cos(TURN_RAD), np.sin(TURN_RAD)
    turn = np.array([[cos, 0, sin, 0], [0, 1, 0, 0], [-sin, 0, cos, 0], [0, 0, 0, 1]])
    (camera,) = (one for one in rig.cameras if one.name == name)
    values = tuple((turn @ camera.T_camera_site.matrix).reshape(16).tolist())
    cameras = file.cameras or {}
    entry = cameras[name].model_copy(update={"T_camera_site": values})
    return file.model_copy(update={"cameras": {**cameras, name: entry}})


def measured(recording: Path, out: Path, *, rig: RigFile | None = None, cameras: bool = True) -> Measured:
    settings = WRITTEN | ({} if cameras else {"detect2d.method": "none"})
    lidcam.process(recording, out, rig=rig, settings=settings, duration_s=0.4)
    figures = lidcam.evaluate(out, settings={"evaluate.bootstrap": 100}).figures
    with open_result(out) as result, open_truth(result, ()) as truth:
        errors = [errors_m(frame) for frame in EvaluationFrames(result, truth)]
    lidar_m, fused_m = np.concatenate(errors, axis=1)
    f1 = {source: float(figures[f"{source}.all.f1"] or 0) for source in ("lidar", "fused")}
    return Measured(f1, lidar_m, fused_m)


def errors_m(frame: EvaluationFrame) -> F64:
    """(2, N) distances on the ground to the lidars' and to the fused box of each object that both have."""
    assert frame.truth is not None
    places, reach_m = frame.truth.centers[:, :2], frame.truth.sizes[:, 0] / 2
    nearest = []
    for source in ("lidar", "fused"):
        found = frame.sources[source].boxes.centers[:, :2]
        distances = np.linalg.norm(places[:, None] - found[None], axis=2)
        nearest.append(distances.min(1, initial=np.inf))
    both = np.array(nearest)
    return both[:, (both < reach_m).all(0)]


SAMPLES = pytest.mark.parametrize(
    ("name", "camera"), [("sandbox.bag", "cam43"), ("crossing.mcap", "camera_north_west")]
)


@SAMPLES
def test_fusion_is_not_worse_than_the_lidars_alone(tmp_path: Path, name: str, camera: str) -> None:
    rig = lidcam.inspect(BAGS / name).rig
    assert rig is not None
    alone = measured(BAGS / name, tmp_path / "alone.mcap", cameras=False)
    found = measured(BAGS / name, tmp_path / "turned.mcap", rig=turned(rig, camera))
    assert found.f1["fused"] >= max(found.f1["lidar"], alone.f1["fused"])
    assert len(found.fused_m) >= 6
    assert found.fused_m.mean() <= 1.02 * found.lidar_m.mean()


@SAMPLES
def test_the_run_names_it(name: str, camera: str) -> None:
    rig = lidcam.inspect(BAGS / name).rig
    assert rig is not None
    report = lidcam.process(BAGS / name, rig=turned(rig, camera), settings=WRITTEN, duration_s=1.2).report
    [warning] = report.warnings
    assert warning.subject == camera
    assert warning.finding.startswith("its 2D boxes lie ")
    assert " degrees) to the left of the objects of the lidars, in " in warning.finding
