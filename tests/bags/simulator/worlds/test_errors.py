from functools import partial

import numpy as np

from lidcam.bags.simulator.scenario.scenario import Scenario, load_scenario
from lidcam.bags.simulator.worlds.errors import with_errors
from lidcam.simulation import scenario_of

EXACT = load_scenario("crossing")


def test_every_sensor_has_errors_of_its_own_within_their_ranges() -> None:
    drawn = [with_errors(EXACT.model_copy(update={"seed": seed})) for seed in range(50)]
    cameras = [camera for one in drawn for camera in one.cameras.values()]
    turned_deg = np.linalg.norm([camera.miscalibration.rpy_deg for camera in cameras], axis=1)
    late_ms = np.array([camera.clock_offset_ms for camera in cameras])
    lidars = [lidar for one in drawn for lidar in one.lidars.values()]
    moved_cm = np.linalg.norm([lidar.miscalibration.xyz_cm for lidar in lidars], axis=1)
    for values, low, high in ((turned_deg, 0.1, 0.3), (moved_cm, 1.0, 3.0), (np.abs(late_ms), 5.0, 20.0)):
        assert len(np.unique(values)) > 0.9 * len(values)
        assert low - 1e-3 < values.min() < values.max() < high + 1e-3
    biases = np.array([camera.detector.edge_bias for camera in cameras if camera.detector])
    assert 0.025 < np.abs(biases).max() <= 0.03
    for values in (biases, late_ms):  # either way
        assert 0.3 < (values > 0).mean() < 0.7


def test_drawn_scenarios_err_unless_asked_not_to() -> None:
    drawn = partial(scenario_of, "random", (), duration_s=None, seed=3, family="road")
    assert drawn() == with_errors(drawn(errors=False)) != drawn(errors=False)
    assert scenario_of("crossing", (), duration_s=None, seed=None) == EXACT


def test_a_seed_has_one_set_of_errors_and_given_ones_stay() -> None:
    given = load_scenario("crossing", ("cameras.camera_north_east.clock_offset_ms=40",))
    erring, plain = with_errors(given), with_errors(EXACT)
    assert erring.cameras["camera_north_east"].clock_offset_ms == 40.0
    assert erring.cameras["camera_north_east"].miscalibration == plain.cameras["camera_north_east"].miscalibration
    assert erring.lidars == plain.lidars
    assert with_errors(erring) == erring == Scenario.model_validate(erring.model_dump(mode="json"))
