import pytest

from bags.simulator.recorder.true_rig import true_rig
from bags.simulator.scenario.load import load_scenario


@pytest.mark.parametrize(
    ("scenario", "zones"), [("sandbox", ["intersection", "circle"]), ("crossing", []), ("vehicle", [])]
)
def test_only_the_sandbox_has_the_zones_of_the_predecessor_system(scenario: str, zones: list[str]) -> None:
    assert [zone.name for zone in true_rig(load_scenario(scenario)).zones] == zones
