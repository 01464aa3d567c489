from typing import get_args

import numpy as np
import pytest

from lidcam.bags.simulator.recorder.stage import Stage
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.worlds.draw import LAYOUTS, Family, random_scenario


def layout_of(scenario: Scenario) -> str:
    beams = np.array(scenario.lidars["top"].elevations_deg)
    alike = {name: layout for name, layout in LAYOUTS.items() if len(layout) == len(beams)}
    return min(alike, key=lambda name: float(np.abs(np.array(alike[name]) - beams).max()))


@pytest.mark.parametrize("family", get_args(Family))
def test_a_seed_has_one_scenario_whose_world_can_be_built(family: Family) -> None:
    scenario = random_scenario(family, 3)
    assert scenario == random_scenario(family, 3)
    assert scenario == Scenario.model_validate(scenario.model_dump(mode="json"))  # as recordings hold it
    other = random_scenario(family, 4)
    assert (scenario.things, scenario.vehicles, scenario.lidars) != (other.things, other.vehicles, other.lidars)
    stage = Stage(scenario)  # refuses what stands in each other
    assert len(stage.scene.movers) == len(scenario.vehicles) - bool(scenario.ego)


@pytest.mark.slow
def test_sixty_seeds_have_seen_it_all() -> None:
    drawn = [random_scenario(get_args(Family)[seed % 3], seed) for seed in range(60)]
    users = [vehicle for scenario in drawn for vehicle in scenario.vehicles.values()]
    assert {user.shape for user in users} == {"model_car", "car", "van", "truck", "bus", "cyclist", "pedestrian"}
    assert {user.body for user in users if user.shape == "car"} == {"hatchback", "saloon", "estate", "mpv"}
    assert {user.posture for user in users} == {"upright", "sitting", "stooping", "reaching"}
    kinds = {thing.kind for scenario in drawn for thing in scenario.things}
    assert kinds >= {"box", "cylinder", "bush", "tree", "fence"}
    assert {layout_of(scenario) for scenario in drawn} == set(LAYOUTS)
    lengths = np.array([4.5 * user.scale[0] for user in users if user.shape == "car" and not user.ego])
    assert 3.7 < lengths.mean() < 4.2
    assert 0.4 < lengths.std() < 0.8
