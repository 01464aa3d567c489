import numpy as np
import pytest

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.scales import is_flip, length_scales, range_edges_m, range_names, range_rows


def test_distances_are_as_long_as_the_class() -> None:
    names = Config().class_names
    scales = dict(zip(names, length_scales(Config()), strict=True))
    assert scales["car"] == 1
    assert scales["pedestrian"] == pytest.approx(0.175)


def test_ranges_are_as_long_as_the_first_class() -> None:
    config = Config()
    small = config.model_copy(update={"classes": (config.classes[0].model_copy(update={"size_m": (0.3, 0.1, 0.1)}),)})
    assert range_names(range_edges_m(config)) == ("0_10", "10_20", "20_40", "40_80", "over_80")
    assert range_names(range_edges_m(small)) == ("0_0p75", "0p75_1p5", "1p5_3", "3_6", "over_6")


def test_a_range_holds_its_nearer_edge() -> None:
    centers = np.array([[0.0, 0, 50], [5, 0, 0], [0, 10, 0], [6, 8, 0], [20, 0, 0], [25, 0, 0]])
    assert range_rows(np.hypot(*centers[:, :2].T), np.array([5.0, 10, 20])).tolist() == [-1, 0, 1, 1, 2, 2]
    assert range_rows(np.zeros(0), np.array([5.0, 10])).tolist() == []


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_flip_is_more_than_a_right_angle_whatever_rounding_makes_of_it(kind: type[np.floating]) -> None:
    right = np.array([np.pi / 2, -np.pi / 2], kind)
    turns_rad = np.concatenate([right, np.nextafter(right, np.sign(right) * kind(4))])
    assert (np.abs(turns_rad.astype(np.float64)) > np.pi / 2).any()
    assert not is_flip(turns_rad).any()
    assert is_flip(np.radians([0, 45, -89.9, 90.1, -90.1, 180])).tolist() == [False] * 3 + [True] * 3
    assert is_flip(np.zeros(0)).tolist() == []
