"""Figures by distance against what nuScenes's devkit says of the same boxes, recorded once.

The boxes were drawn at random: usual ones, equal scores, crowds, all ten classes, few found, none found, all false. A
row is the frame, class, x, y, z, length, width, height and yaw, then the lidar points of the truth, or a score. The
devkit (its version stands in the file) was asked as `detection_cvpr_2019` has it, from a vehicle at the origin.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evaluation_frames import evaluated, source_boxes, truth_boxes

from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame

RECORDED = json.loads((Path(__file__).parent / "recorded" / "nuscenes.json").read_text())
RANGES_M = {"car": 50, "truck": 50, "bus": 50, "pedestrian": 40, "motorcycle": 40, "bicycle": 40}
"""How far each class is evaluated there (`detection_cvpr_2019`), but for classes with rules of their own."""

SIZE_M = (4.0, 2.0, 1.5)  # so that nothing is scaled
CONFIG = Config(classes=tuple(ClassPrior(name=name, size_m=SIZE_M, max_size_m=SIZE_M) for name in RANGES_M))


def columns(rows: list[Any], frame: int) -> tuple[Any, Any, list[int]]:
    """What the devkit takes away before it matches, what is too far and what no lidar hits, is not among them."""
    kept = [row for row in rows if row[0] == frame and np.hypot(row[2], row[3]) < RANGES_M.get(row[1], 0) and row[-1]]
    numbers = np.array([row[2:] for row in kept], np.float64).reshape(-1, 8)
    return numbers[:, :7], numbers[:, 7], [[*RANGES_M].index(row[1]) for row in kept]


@pytest.mark.parametrize("name", RECORDED["cases"])
def test_equal_to_the_devkit(name: str) -> None:
    case, frames, compared = RECORDED["cases"][name], [], 0
    for frame in range(case["frames"]):
        rows, points, ids = columns(case["truth"], frame)
        truth = truth_boxes(rows, class_ids=ids, lidar_points=points)
        rows, scores, ids = columns(case["found"], frame)
        found = source_boxes(rows, scores=scores, class_ids=ids)
        frames.append(EvaluationFrame(frame, frame, truth, {"lidar": found}))
    figures = evaluated(frames, CONFIG)["sources"]["lidar"]
    for class_name in RANGES_M:
        if not figures[class_name]["truth"]:
            continue
        ours, theirs = figures[class_name]["distance"], case["figures"][class_name]
        assert {key: ours[key] for key in theirs} == pytest.approx(theirs, abs=1e-6)
        compared += 1
    assert compared or not case["truth"]
