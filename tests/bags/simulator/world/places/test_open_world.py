from typing import get_args

import numpy as np
import pytest

from lidcam.bags.simulator.scenario.scenario import GroundScenario, RoadScenario, ThingKind, ThingScenario
from lidcam.bags.simulator.vehicles.footprints import things_in_the_way
from lidcam.bags.simulator.world.places.open_world import open_height, open_mesh
from lidcam.bags.simulator.world.scene import Rays, Scene

ROAD = RoadScenario(from_m=(-50, 0), to_m=(50, 0), width_m=8)
GROUND = GroundScenario(
    reach_m=60, roads=(ROAD,), kerb_m=0.15, slope=(0.02, -0.01), waves_m=0.5, wave_length_m=40, roughness_m=0.01, seed=3
)


def test_the_ground_lies_where_its_height_says() -> None:
    places = np.random.default_rng(1).uniform(-50, 50, (2000, 2))
    origins = np.c_[places, np.full(2000, 9.0)]
    hits = Scene(open_mesh(GROUND, ()), []).cast(
        Rays(origins, np.tile([0.0, 0, -1], (2000, 1)), np.zeros(2000, np.int64))
    )
    off = 9.0 - hits.distance_m - open_height(GROUND, places)
    kerb = (np.abs(np.abs(places[:, 1]) - 4) < 0.1) | (np.abs(places[:, 0]) > 46)  # the end of a road is a ramp
    assert np.abs(off[~kerb]).max() < 0.05
    assert 0.001 < off[~kerb].std() < 0.02
    assert np.abs(off).max() < 0.2


def test_roads_lie_below_what_is_beside_them() -> None:
    flat = GroundScenario(roads=(ROAD,), kerb_m=0.15)
    heights = open_height(flat, np.array([[0, 0], [0, 3.9], [0, 4.1], [49, -3], [51, 0]]))
    np.testing.assert_allclose(heights, [0, 0, 0.15, 0, 0.15])
    assert open_height(GROUND, np.zeros((1, 2)))[0] == 0.0


@pytest.mark.parametrize("kind", get_args(ThingKind))
def test_a_thing_fills_its_size_where_it_stands(kind: ThingKind) -> None:
    thing = ThingScenario(kind=kind, position_m=(5, -20), size_m=(2.0, 1.0, 1.5), yaw_deg=90, bottom_m=0.3)
    bare, mesh = open_mesh(GROUND, ()), open_mesh(GROUND, (thing,))
    low, high = (end(mesh.vertices[len(bare.vertices) :], axis=0) for end in (np.min, np.max))
    middle = np.array([5, -20, open_height(GROUND, np.array([[5.0, -20.0]]))[0] + 0.3])
    assert (low >= middle - np.array([0.5, 1.0, 0.0]) - 1e-9).all()
    assert (high <= middle + np.array([0.5, 1.0, 1.5]) + 1e-9).all()
    assert (high - low > np.array([0.5, 0.5, 0.4]) * (1.0, 2.0, 1.5)).all()
    np.testing.assert_array_equal(open_mesh(GROUND, (thing,)).vertices, mesh.vertices)


def test_what_stands_in_the_way_of_a_car() -> None:
    sizes = {"box": (1, 1, 1), "grass": (2, 2, 0.4), "tree": (4, 4, 6)}
    things = [ThingScenario(kind=kind, position_m=(0, 0), size_m=size) for kind, size in sizes.items()]
    things += [
        ThingScenario(position_m=(9, 0), size_m=(1, 1, 0.1)),
        ThingScenario(position_m=(9, 0), size_m=(1, 1, 1), bottom_m=2.5),
    ]
    found = things_in_the_way(things, step_m=0.2, headroom_m=2.2)
    assert [(one.length_m, one.width_m) for one in found] == [(1, 1), (pytest.approx(0.48), pytest.approx(0.48))]
