import numpy as np
import pytest
from small_worlds import GREY, RETRO

from lidcam.bags.simulator.sensors.echoes import NO_ECHO, Echoes, Reflected, distinct_echoes, intensity, returned_share
from lidcam.bags.simulator.world.mesh import Material

MIRROR = Material("mirror", (1, 1, 1), 1.0, mirror=0.5)


def share(material: Material, incidence_deg: float) -> float:
    cos = np.array([np.cos(np.deg2rad(incidence_deg))])
    return float(returned_share(np.array([material.reflectivity]), np.array([material.mirror]), cos)[0])


def echoes(surfaces: list[tuple[float, float, int]], *, second_strongest: bool = False, reach_m: float = 100) -> Echoes:
    """Of one beam that meets surfaces (range, share, mover)."""
    range_m, share, mover = (np.array(column) for column in zip(*surfaces, strict=True))
    return distinct_echoes(
        Reflected(np.zeros(len(mover), np.int64), range_m.astype(np.float64), share.astype(np.float64), mover),
        1,
        reach_m=reach_m,
        nearest_m=1.0,
        apart_m=0.5,
        second_strongest=second_strongest,
    )


def test_at_grazing_angles_rough_ground_is_seen_and_a_mirror_is_not() -> None:
    assert share(GREY, 88) > 0.3 * GREY.reflectivity
    assert share(MIRROR, 88) < 0.01
    assert share(RETRO, 60) == RETRO.reflectivity


def test_intensity_is_on_the_scale_of_velodyne() -> None:
    shares = np.array([0.0, 0.1, 0.5, 1.0, 1.01, 2.0, 5.0, 1e9])
    assert intensity(shares).tolist() == [0, 10, 50, 100, 103, 178, 224, 255]


def test_the_strongest_is_the_one_of_which_max_reflectivity_arrives() -> None:
    far = echoes([(10.0, 0.02, 3), (30.0, 0.3, 7)])
    assert far.range_m.tolist() == [[30.0, 30.0]]
    near = echoes([(10.0, 0.04, 3), (30.0, 0.3, 7)])
    assert near.range_m.tolist() == [[10.0, 30.0]]
    assert near.share.tolist() == [[0.04, 0.3]]


def test_two_echoes_are_sent_though_the_last_is_the_strongest() -> None:
    found = echoes([(10.0, 0.02, 3), (30.0, 0.3, 7)], second_strongest=True)
    assert found.range_m.tolist() == [[10.0, 30.0]]
    assert found.mover.tolist() == [[3, 7]]
    alone = echoes([(10.0, 0.0001, 3), (30.0, 0.3, 7)], second_strongest=True)
    assert alone.range_m.tolist() == [[30.0, 30.0]]


def test_surfaces_close_together_make_one_echo_between_them() -> None:
    found = echoes([(10.0, 0.3, 1), (10.4, 0.1, 2)])
    assert found.range_m.tolist() == [[pytest.approx(10.1)] * 2]
    assert found.share.tolist() == [[pytest.approx(0.4)] * 2]
    assert found.mover.tolist() == [[1, 1]]


@pytest.mark.parametrize(
    "surface",
    [(np.inf, 0.5, 0), (0.9, 1.0, 0), (50.0, 0.0, 0), (50.0, 0.24, 0)],
    ids=["nothing", "too near", "black", "too dark"],
)
def test_no_echo(surface: tuple[float, float, int]) -> None:
    assert echoes([surface, (np.inf, 0.0, -1)]).range_m.tolist() == [[NO_ECHO, NO_ECHO]]
