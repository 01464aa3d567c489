"""Positions of the objects that two sources both found."""

from typing import Any

import numpy as np
import pytest
from evaluation_scenes import boxes3d, evaluated, truth3d

from pipeline.core.settings.classes import ClassPrior
from pipeline.core.settings.config import Config
from pipeline.core.settings.evaluate import EvaluateConfig
from pipeline.evaluation.records import EvaluationFrame

CLASSES = tuple(ClassPrior(name=name, size_m=(4.0, 2.0, 1.5), max_size_m=(9.0, 9.0, 9.0)) for name in ("car", "bus"))
CONFIG = Config(classes=CLASSES, evaluate=EvaluateConfig(bootstrap=100, ranges_m=(0, 100), iou=(0.5,)))
PLACES_M = np.array([[0.0, 0, 0], [20.0, 0, 0], [40.0, 0, 0]])


def gain(lidar_m: list[float | None], fused_m: list[float | None], *, frames: int = 1) -> Any:
    """Of cars at `PLACES_M`, each found so far off, or not at all."""

    def found(off_m: list[float | None]) -> Any:
        rows = [row for row, one in enumerate(off_m) if one is not None]
        shift = np.array([[0.0, off_m[row] or 0.0, 0.0] for row in rows]).reshape(-1, 3)
        n = len(rows)
        sizes = np.full((n, 3), (4.0, 2.0, 1.5))
        return boxes3d(PLACES_M[rows] + shift, sizes, np.zeros(n), np.full(n, 0.9), np.zeros(n, np.int64))

    truth = truth3d(PLACES_M, np.full((3, 3), (4.0, 2.0, 1.5)), np.zeros(3), np.zeros(3, np.int64))
    sources = {"lidar": found(lidar_m), "fused": found(fused_m)}
    made = [EvaluationFrame(index, index * 10**9, truth, sources) for index in range(frames)]
    return evaluated(made, CONFIG)["fusion_gain"]


def test_only_what_both_found_counts() -> None:
    found = gain([0.1, None, 0.4], [0.3, 1.0, 0.2])
    assert found["car"]["errors"]["position_bev_m"]["mean"]["value"] == pytest.approx(0.25 - 0.5)
    same = {"objects": 2, "value": pytest.approx(0.0, abs=1e-6), "low": None, "high": None, "takes_away": None}
    assert found["car"]["same_objects"] == {"lidar": same}
    assert found["all"]["same_objects"]["lidar"] == same


def test_nothing_in_common_has_no_value() -> None:
    found = gain([0.1, None, None], [None, 0.1, None])["car"]["same_objects"]["lidar"]
    assert found == {"objects": 0, "value": None, "low": None, "high": None, "takes_away": None}
    assert gain([0.1, 0.1, 0.1], [0.1, 0.1, 0.1])["bus"]["same_objects"]["lidar"]["objects"] == 0


@pytest.mark.parametrize(("fused_m", "takes_away"), [(0.1, False), (0.9, True), (0.5, False)])
def test_the_interval_of_equal_frames_is_their_value(fused_m: float, takes_away: bool) -> None:
    found = gain([0.5] * 3, [fused_m] * 3, frames=6)["car"]["same_objects"]["lidar"]
    assert found["objects"] == 18
    for name in ("value", "low", "high"):
        assert found[name] == pytest.approx(0.5 - fused_m, abs=1e-6)
    assert found["takes_away"] is takes_away
