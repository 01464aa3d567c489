"""Figures that carry nuScenes's name against what its devkit says of the same boxes, recorded once."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evaluation_scenes import boxes3d, evaluated, truth3d

from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame
from lidcam.pipeline.evaluation.scales import NUSCENES_RANGES_M

RECORDED = json.loads((Path(__file__).parent / "recorded" / "nuscenes.json").read_text())
SIZE_M = (4.0, 2.0, 1.5)


def config(names: tuple[str, ...]) -> Config:
    classes = tuple(ClassPrior(name=name, size_m=SIZE_M, max_size_m=SIZE_M) for name in names)
    return Config(classes=classes, evaluate=EvaluateConfig(distances="nuscenes"))


def columns(rows: list[Any], frame: int, names: tuple[str, ...]) -> list[Any]:
    rows = [row for row in rows if row[0] == frame and row[1] in names]
    numbers = np.array([row[2:] for row in rows], np.float64).reshape(-1, 8)
    return [numbers[:, :3], numbers[:, 3:6], numbers[:, 6], numbers[:, 7], [names.index(row[1]) for row in rows]]


def figures(case: dict[str, Any], names: tuple[str, ...]) -> Any:
    frames = []
    for frame in range(case["frames"]):
        centers, sizes, yaws, points, ids = columns(case["truth"], frame, names)
        truth = truth3d(centers, sizes, yaws, ids, lidar_points=points)
        found = boxes3d(*columns(case["found"], frame, names))
        frames.append(EvaluationFrame(frame, frame, truth, {"lidar": found}))
    return evaluated(frames, config(names))["sources"]


@pytest.mark.parametrize("name", RECORDED["cases"])
def test_equal_to_the_devkit(name: str) -> None:
    case = RECORDED["cases"][name]
    ours = figures(case, tuple(NUSCENES_RANGES_M))["lidar"]
    for class_name, expected in case["figures"].items():
        found = {key: ours[class_name]["nuscenes"][key] for key in expected}
        assert found == pytest.approx(expected, abs=1e-6), class_name


def test_the_devkit_counts_classes_that_nobody_looks_for() -> None:
    case = RECORDED["cases"]["usual"]
    ours = figures(case, ("car", "pedestrian", "truck", "bus"))["lidar"]
    expected = case["figures"]["all"]
    assert {key: ours["all"]["nuscenes"][key] for key in expected} == pytest.approx(expected, abs=1e-6)


def test_a_class_that_nuscenes_does_not_have_has_none_of_its_figures() -> None:
    box = [0, "tram", 1, 1, 1, 4, 2, 1, 0]
    ours = figures({"frames": 1, "truth": [[*box, 5]], "found": [[*box, 0.5]]}, ("tram",))["lidar"]["tram"]
    assert ours["right"] == 1
    assert {value for name, value in ours["nuscenes"].items() if name != "thresholds"} == {None}
