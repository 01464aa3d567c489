"""A camera that is turned by two degrees against its calibration: it is named, and fusion stays better than lidars."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers import BAGS

import lidcam
from lidcam.readers.rig.rig_file import rig_yaml
from lidcam.readers.rig.schema import RigFile, parse_rig

TURN_RAD = np.radians(2.0)
WRITTEN = {"output.images": False, "output.clouds": False, "run.workers": 1}
SAMPLES = [
    ("sandbox.bag", "cam43", 0.4),
    pytest.param("crossing.mcap", "camera_north_west", 1.6, marks=pytest.mark.slow),
]


def turned(recording: Path, name: str) -> RigFile:
    """The rig of a recording with a camera turned about its own vertical axis."""
    rig = lidcam.inspect(recording).rig
    assert rig is not None
    file = parse_rig(yaml.safe_load(rig_yaml(rig)), Path("rig.yaml"))
    cos, sin = np.cos(TURN_RAD), np.sin(TURN_RAD)
    turn = np.array([[cos, 0, sin, 0], [0, 1, 0, 0], [-sin, 0, cos, 0], [0, 0, 0, 1]])
    (camera,) = (one for one in rig.cameras if one.name == name)
    values = tuple((turn @ camera.T_camera_site.matrix).reshape(16).tolist())
    cameras = file.cameras or {}
    entry = cameras[name].model_copy(update={"T_camera_site": values})
    return file.model_copy(update={"cameras": {**cameras, name: entry}})


@pytest.mark.parametrize(("name", "camera", "duration_s"), SAMPLES)
def test_fusion_is_not_worse_than_the_lidars_alone_and_a_longer_run_names_the_camera(
    tmp_path: Path, name: str, camera: str, duration_s: float
) -> None:
    alone, out = tmp_path / "alone.mcap", tmp_path / "turned.mcap"
    lidcam.process(BAGS / name, alone, settings=WRITTEN | {"detect2d.method": "none"}, duration_s=duration_s)
    run = lidcam.process(BAGS / name, out, rig=turned(BAGS / name, camera), settings=WRITTEN, duration_s=duration_s)
    lidars, fused = (lidcam.evaluate(path).figures for path in (alone, out))
    assert float(fused["fused.all.f1"] or 0) >= max(
        float(fused["lidar.all.f1"] or 0), float(lidars["fused.all.f1"] or 0)
    )
    assert float(fused["fusion_gain.all.errors.position_bev_m.mean.value"] or -1) >= 0
    if duration_s > 1:
        [warning] = run.summary.warnings
        assert warning.subject == camera
        assert " objects, it looks 2.0" in warning.finding
        assert " degrees further right" in warning.finding
