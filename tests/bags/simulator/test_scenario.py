from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lidcam.bags.simulator.recorder.stage import true_rig
from lidcam.bags.simulator.scenario.scenario import Scenario, load_scenario
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.geometry.transform import rotation_fault

LIDAR = {"topic": "/points", "frame_id": "lidar", "position_m": [0, 0, 1]}
CAMERA = {"topic": "/image", "info_topic": "/info", "frame_id": "cam", "position_m": [0, 0, 1], "focal_px": [500, 500]}


def tree(**changes: Any) -> dict[str, Any]:
    return {"world": "sandbox", "lidars": {"top": LIDAR}, "cameras": {"front": CAMERA}} | changes


def written(path: Path, content: dict[str, Any]) -> str:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("name", ["crossing", "sandbox", "vehicle"])
def test_scenarios_are_sound(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.description
    assert scenario.lidars
    assert scenario.cameras
    assert scenario.vehicles
    for sensor in [*scenario.lidars.values(), *scenario.cameras.values()]:
        assert rotation_fault(sensor.T_carrier_body("site").matrix[:3, :3]) is None


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path / "mine.yaml", tree()), ("seed=5", "lidars.top.rate_hz=20"))
    assert (scenario.seed, scenario.lidars["top"].rate_hz, scenario.start_ns) == (5, 20.0, 1_700_000_000 * 10**9)


def test_a_star_stands_for_every_name(tmp_path: Path) -> None:
    lidars = {"top": LIDAR, "side": LIDAR | {"topic": "/side", "frame_id": "side"}}
    path = written(tmp_path / "mine.yaml", tree(lidars=lidars))
    scenario = load_scenario(path, ("lidars.*.rate_hz=20", "lidars.side.rate_hz=5"))
    assert {name: lidar.rate_hz for name, lidar in scenario.lidars.items()} == {"top": 20.0, "side": 5.0}
    with pytest.raises(ConfigError, match=r"settings: routes\.\*\.closed=true: expected names for"):
        load_scenario(path, ("routes.*.closed=true",))
    with pytest.raises(ConfigError, match="expected a section before"):
        load_scenario(path, ("*.top.rate_hz=3",))


def test_a_sensors_body_is_turned_about_the_axes_of_what_carries_it() -> None:
    scenario = Scenario.model_validate(tree(lidars={"top": LIDAR | {"rpy_deg": [0, 90, 0]}}))
    pose = scenario.lidars["top"].T_carrier_body("site")
    np.testing.assert_allclose(pose.matrix[:3, 0], [0, 0, -1], atol=1e-12)  # it looks down


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wolrd": "sandbox"}, "unknown key 'wolrd'"),
        ({"world": "moon"}, "world"),
        ({"lidars": {"top": LIDAR | {"mounted_on": "car"}}}, "top.mounted_on: expected the ego vehicle or nothing"),
        ({"lidars": {"a": LIDAR, "b": LIDAR}}, "lidars.b: '/points' is also a topic of lidars.a"),
        ({"cameras": {"a": CAMERA | {"frame_id": "site"}}}, "cameras.a: 'site' is also a frame of the simulator"),
        ({"cameras": {"a": CAMERA | {"distortion": [0.1] * 6}}}, "at most 5 coefficients for plumb_bob, found 6"),
        ({"lidars": {"a": LIDAR | {"elevation_deg": [3, -25]}}}, "expected the lower one first"),
        ({"lidars": {"a": LIDAR | {"output": "packets"}}}, "expected a Velodyne model and a packets_topic for packets"),
        (
            {"lidars": {"a": LIDAR | {"output": "both", "packets_topic": "/p", "firing_stride": 2}}},
            "expected 1 for packets, which hold every firing, found 2",
        ),
        ({"lidars": {"a": LIDAR | {"elevations_deg": [1]}}}, "elevations_deg: expected none of a VLP-16"),
        (
            {"things": [{"position_m": [0, 0], "size_m": [1, 1, 1]}]},
            "expected open for ground and things, found sandbox",
        ),
        ({"vehicles": {"a": {"route": "r"}}}, "vehicles.a.route: expected one of none, found 'r'"),
        ({"vehicles": {"a": {"ego": True}, "b": {"ego": True}}}, "expected at most one ego, found a, b"),
        (
            {"routes": {"r": {"points_m": [[0, 0], [1, 0]]}}, "vehicles": {"a": {"route": "r", "keys": "w"}}},
            "expected a route or keys, found both",
        ),
        (
            {"routes": {"r": {"points_m": [[0, 0], [1, 0]], "yields_to": ["q"]}}},
            "routes.r.yields_to: expected one of r, found 'q'",
        ),
        ({"vehicles": {"a": {"shape": "pedestrian", "keys": "w"}}}, "expected a route for a pedestrian"),
        ({"vehicles": {"a": {"shape": "pedestrian", "commands": True}}}, "expected a route for a pedestrian"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=r"mine\.yaml") as error:
        load_scenario(written(tmp_path / "mine.yaml", tree(**changes)))
    assert message in str(error.value)


@pytest.mark.parametrize("name", ["nothing", "no.yaml", 300 * "x", "../scenarios/sandbox"])
def test_a_scenario_that_is_not_there(name: str) -> None:
    with pytest.raises(ConfigError, match=r": expected one of crossing, sandbox, vehicle|no\.yaml"):
        load_scenario(name)


@pytest.mark.parametrize(
    ("scenario", "zones"), [("sandbox", ["intersection", "circle"]), ("crossing", []), ("vehicle", [])]
)
def test_only_the_sandbox_has_the_zones_of_the_predecessor_system(scenario: str, zones: list[str]) -> None:
    assert [zone.name for zone in true_rig(load_scenario(scenario)).zones] == zones
