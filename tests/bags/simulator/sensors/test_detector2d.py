from typing import Any

import numpy as np
import pytest

from lidcam.bags.simulator.scenario.sensors import Detector2DScenario
from lidcam.bags.simulator.sensors.camera import CameraImage
from lidcam.bags.simulator.sensors.visibility import Detected, detect, visible_boxes

CLASSES = ("car", "pedestrian", "truck")


def image(*, hidden: float = 0.0, height: int = 60) -> CameraImage:
    """A car of 80 x `height`, its left part hidden by a pedestrian, and a truck that is not seen."""
    movers = np.full((240, 320), -1, np.int16)
    movers[100 : 100 + height, 50:130] = 0
    edge = 50 + round(80 * hidden)
    movers[100 : 100 + height, 50:edge] = -1
    movers[90:170, 20:50] = 1
    boxes = np.array([[50.0, 100, 130, 100 + height], [20, 90, 50, 170], [np.nan] * 4])
    rgb = np.zeros((240, 320, 3), np.uint8)
    return CameraImage(rgb, movers, np.array([80 * height, 30 * 80, 0], np.int64), boxes)


def detected(shown: CameraImage, *, number: int = 0, **how: Any) -> Detected:
    settings = {"pixel_noise_px": 0.0, "miss_rate": 0.0, "false_per_image": 0.0} | how
    scenario = Detector2DScenario.model_validate({"topic": "/detections"} | settings)
    return detect(scenario, shown, CLASSES, name="front", number=number, seed=1)


def test_boxes_of_what_is_visible() -> None:
    shown = image(hidden=0.25)
    np.testing.assert_array_equal(visible_boxes(shown)[:2], [[70, 100, 130, 160], [20, 90, 50, 170]])
    assert np.isnan(visible_boxes(shown)[2]).all()
    found = detected(shown)
    np.testing.assert_array_equal(found.xyxy, visible_boxes(shown)[:2])
    np.testing.assert_array_equal(found.movers, [0, 1])
    assert found.class_names == ("car", "pedestrian")


@pytest.mark.parametrize(
    ("shown", "how", "movers"),
    [
        (image(hidden=0.6), {"min_visible": 0.3}, [0, 1]),
        (image(hidden=0.8), {"min_visible": 0.3}, [1]),
        (image(height=11), {"min_height_px": 12.0}, [1]),
        (image(), {"miss_rate": 1.0}, []),
        (image(), {"min_height_px": 300.0}, []),
    ],
    ids=["half hidden", "hidden", "small", "all missed", "all small"],
)
def test_what_is_not_found(shown: CameraImage, how: dict[str, Any], movers: list[int]) -> None:
    found = detected(shown, **how)
    np.testing.assert_array_equal(found.movers, movers)
    assert found.xyxy.shape == (len(movers), 4)
    assert found.scores.shape == (len(movers),)


def test_a_habit_moves_edges_outward_by_shares_of_each_box() -> None:
    found = detected(image(), edge_bias=(0.05, -0.1, 0.025, 0.1))
    np.testing.assert_allclose(found.xyxy, np.array([[46, 106, 132, 166], [18.5, 98, 50.75, 178]]))


def test_rates_and_noise_are_those_asked_for() -> None:
    found = [detected(image(), number=n, miss_rate=0.2, pixel_noise_px=1.5, false_per_image=0.5) for n in range(600)]
    true = [one.movers >= 0 for one in found]
    assert sum(rows.sum() for rows in true) / 1200 == pytest.approx(0.8, abs=0.04)
    assert sum((~rows).sum() for rows in true) / 600 == pytest.approx(0.5, abs=0.1)
    edges = np.concatenate([one.xyxy[one.movers == 0] for one in found]) - (50, 100, 130, 160)
    assert edges.std() == pytest.approx(1.5, rel=0.06)
    assert abs(edges.mean()) < 0.1
