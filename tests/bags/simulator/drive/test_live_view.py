import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import rerun as rr
from small_scenario import small_scenario

from lidcam.bags.simulator.drive.live_view import LiveView
from lidcam.bags.simulator.recorder.start import simulating
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.ros.typestores import RosVersion

RERUN = Path(sys.executable).with_name("rerun")
RIDING = {"mounted_on": "car2", "position_m": [0.0, 0.0, 0.4]}


def shown(folder: Path, scenario: dict[str, Any], version: RosVersion = 2) -> set[str]:
    """The entities that a simulation shows."""
    path, stream = folder / "view.rrd", rr.RecordingStream("test")
    stream.save(path)
    with simulating(Scenario.model_validate(scenario), ros_version=version, workers=1) as simulation:
        view = LiveView(simulation, stream)
        for recorded in simulation.run(0.3):
            view.show(recorded)
    stream.disconnect()
    environment = {"HOME": str(folder), "PATH": "/usr/bin:/bin"}
    command = [str(RERUN), "rrd", "print", "-v", str(path)]
    text = subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout
    return set(re.findall(r"(/world[\w/]*)", text))


@pytest.mark.parametrize(("version", "output"), [(1, "jpeg"), (2, "raw")])
def test_sensors_and_truth_are_shown(tmp_path: Path, version: RosVersion, output: str) -> None:
    found = shown(tmp_path, small_scenario(cameras__front__output=output), version)
    assert {"/world", "/world/top", "/world/front", "/world/truth"} <= found


def test_an_ego_vehicle_moves_its_sensors(tmp_path: Path) -> None:
    changes = {f"{kind}__{key}": value for kind in ("lidars__top", "cameras__front") for key, value in RIDING.items()}
    found = shown(tmp_path, small_scenario(vehicles__car2__ego=True, **changes))
    assert {"/world/base_link", "/world/base_link/top", "/world/base_link/front"} <= found


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no DISPLAY")
def test_a_viewer_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with (
        simulating(Scenario.model_validate(small_scenario()), ros_version=2, workers=1) as simulation,
        pytest.raises(OutputError, match="expected a display"),
    ):
        LiveView(simulation, rr.RecordingStream("test")).spawn()
