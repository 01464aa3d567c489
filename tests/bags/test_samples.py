"""The sample recordings are the ones that their README describes."""

import hashlib
import shlex
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from lidcam.bags.simulator.recorder.true_rig import true_rig
from lidcam.bags.simulator.scenario.load import load_scenario
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.readers.rig.rig_file import load_rig

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "bags" / "README.md").read_text(encoding="utf-8")
SAMPLES = ["sandbox.bag", "crossing.mcap"]


def scenario_of(name: str) -> Scenario:
    """What a recording says that it was recorded from."""
    path = ROOT / "bags" / name
    if path.suffix == ".bag":
        text = path.with_name(f"{name}.scenario.yaml").read_text(encoding="utf-8")
    else:
        with path.open("rb") as stream:
            attached = {one.name: one.data for one in make_reader(stream).iter_attachments()}
        text = attached["scenario.yaml"].decode()
    return Scenario.model_validate(yaml.safe_load(text))


@pytest.mark.parametrize("name", SAMPLES)
def test_readme_tells_size_and_hash(name: str) -> None:
    data = (ROOT / "bags" / name).read_bytes()
    [row] = [line for line in README.splitlines() if line.startswith(f"| `{name}` |")]
    assert f"{len(data)} bytes" in row
    assert hashlib.sha256(data).hexdigest() in row


@pytest.mark.parametrize("name", SAMPLES)
def test_the_command_in_the_readme_is_the_one_that_recorded_it(name: str) -> None:
    [command] = [line for line in README.splitlines() if line.startswith("lidcam simulate ") and f"bags/{name}" in line]
    assert f"\t$(BIN)/{command}" in (ROOT / "Makefile").read_text(encoding="utf-8")
    arguments = shlex.split(command)
    overrides = [value for key, value in pairwise(arguments) if key == "--set"]
    duration_s = float(arguments[arguments.index("--duration") + 1])
    asked_for = load_scenario(arguments[2], tuple(overrides)).model_copy(update={"duration_s": duration_s})
    assert asked_for == scenario_of(name)


def test_the_readme_tells_where_the_sandbox_differs_from_the_predecessors_rig() -> None:
    site, old = true_rig(load_scenario("sandbox")), load_rig(ROOT / "config" / "rigs" / "original.yaml")
    words = " ".join(README.split())
    assert old.lidars
    assert old.cameras
    for lidar in site.lidars:
        shift = lidar.T_site_lidar.translation - np.array(old.lidars[lidar.name].translation_m)
        turn_deg = Rotation.from_matrix(lidar.T_site_lidar.matrix[:3, :3]).as_euler("ZYX", degrees=True)[0]
        assert shift == pytest.approx([0, 0, 0.25], abs=1e-6)
        assert turn_deg == pytest.approx({"velodyne1": 0, "velodyne2": 120, "velodyne3": -90}[lidar.name])
    assert "0.25 m higher" in words
    assert "velodyne2 is turned by 120 degrees, velodyne3 by -90" in words
    for camera in site.cameras:
        if camera.name != "cam12":
            pose, published = camera.T_camera_site.inverse().matrix, old.cameras[camera.name].matrix()
            assert pose[:3, 3] == pytest.approx(published[:3, 3])
            down_deg = np.degrees(np.arccos(pose[:3, 2] @ published[:3, 2]))
            assert down_deg == pytest.approx(18 if camera.name < "cam2" else 14)
    assert "cameras 11, 13 and 14 look 18 degrees down and cameras 41 to 44 look 14 degrees down" in words
