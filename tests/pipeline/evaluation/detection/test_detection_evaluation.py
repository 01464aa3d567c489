"""Detections that are right, false or ignored, and missed objects, by place."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evaluation_frames import evaluated, source_boxes, truth_boxes

from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, SourceBoxes, TruthBoxes3D

CAR, VAN = 0, 1
SIZE_M = (4.0, 2.0, 1.5)
CLASSES = (
    ClassPrior(name="car", size_m=SIZE_M, max_size_m=(9.0, 9.0, 9.0)),
    ClassPrior(name="van", size_m=(8.0, 2.0, 2.0), max_size_m=(9.0, 9.0, 9.0)),
)
COUNTS = ("truth", "truth_ignored", "found", "right", "missed", "false", "ignored")


def config(**settings: Any) -> Config:
    return Config(classes=CLASSES, evaluate=EvaluateConfig(**settings))


def truth(*xy: tuple[float, float], **columns: Any) -> TruthBoxes3D:
    return truth_boxes([(x, y, 1.0, *SIZE_M, 0.0) for x, y in xy], **columns)


def found(*xys: tuple[float, float, float], class_ids: Any = None) -> SourceBoxes:
    rows, scores = [(x, y, 1.0, *SIZE_M, 0.0) for x, y, _ in xys], [score for *_, score in xys]
    return source_boxes(rows, scores=scores, class_ids=class_ids)


def figures(true: TruthBoxes3D | None, boxes: SourceBoxes, settings: Config | None = None, zones: Any = ()) -> Any:
    frame = EvaluationFrame(0, 0, true, {"lidar": boxes})
    return evaluated([frame], config() if settings is None else settings, zones)["sources"]["lidar"]


def counts(tree: Any) -> dict[str, int]:
    return {name: tree[name] for name in COUNTS if tree[name]}


def test_each_true_object_is_found_once() -> None:
    both = figures(truth((10, 0)), found((10.1, 0, 0.5), (10.2, 0, 0.9)))["car"]
    assert counts(both) == {"truth": 1, "found": 2, "right": 1, "false": 1}
    # the higher score is right, though it is farther away
    assert both["errors"]["position_bev_m"]["mean"] == pytest.approx(0.2)
    assert (both["precision"], both["recall"], both["f1"], both["false_per_frame"]) == (0.5, 1.0, 2 / 3, 1.0)


@pytest.mark.parametrize(("class_id", "max_m"), [(CAR, 2), (VAN, 4)])
@pytest.mark.parametrize(("beyond_m", "right"), [(-0.01, 1), (0.01, 0)])
def test_half_the_length_of_its_class_may_lie_between(class_id: int, max_m: float, beyond_m: float, right: int) -> None:
    boxes = found((10 + max_m + beyond_m, 0, 0.9), class_ids=[class_id])
    tree = figures(truth((10, 0), class_ids=[class_id]), boxes)[CLASSES[class_id].name]
    assert tree["right"] == right
    assert [row["distance_m"] for row in tree["distance"]["thresholds"]] == [max_m * k for k in (0.25, 0.5, 1, 2)]
    assert (tree["distance"]["ap_2"] > 0) == bool(right)


@pytest.mark.parametrize(
    "columns",
    [
        {"is_ignored": [True]},
        {"class_ids": [UNKNOWN]},
        {"lidar_points": [0], "image_pixels": [0]},
        {"lidar_points": [0]},
        {"image_pixels": [0]},
    ],
)
def test_what_is_ignored_is_neither_missed_nor_an_error(columns: dict[str, Any]) -> None:
    boxes = found((10.5, 0, 0.9), (9.5, 0.3, 0.8), class_ids=[CAR, VAN])
    tree = figures(truth((10, 0), **columns), boxes)
    assert counts(tree["all"]) == {"truth_ignored": 1, "found": 2, "ignored": 2}
    assert tree["all"]["precision"] is tree["all"]["recall"] is tree["all"]["ap_bev_r40_50"] is None
    assert counts(figures(truth((10, 0), **columns), found())["all"]) == {"truth_ignored": 1}


@pytest.mark.parametrize("columns", [{"lidar_points": [0], "image_pixels": [0]}, {"image_pixels": [0]}])
def test_hidden_objects_have_to_be_found_where_that_is_asked_for(columns: dict[str, Any]) -> None:
    tree = figures(truth((10, 0), **columns), found((10, 0, 0.9)), config(min_lidar_points=0))
    assert counts(tree["car"]) == {"truth": 1, "found": 1, "right": 1}


@pytest.mark.parametrize("settings", [{"max_range_m": 20.0}, {"region": ((-20, -20), (20, -20), (20, 20), (-20, 20))}])
def test_what_lies_outside_is_not_evaluated(settings: dict[str, Any]) -> None:
    true = truth((10, 0), (19.5, 0), (20.5, 5), (60, 0))
    boxes = found((10, 0, 0.9), (20.4, 0, 0.8), (19.8, 5, 0.7), (60, 0, 0.6), (40, 0, 0.5), (0, 10, 0.4))
    # at the border, what shows an object inside is right, and what shows one outside is ignored
    expected = {"truth": 2, "truth_ignored": 2, "found": 6, "right": 2, "ignored": 3, "false": 1}
    tree = figures(true, boxes, config(**settings))["car"]
    assert counts(tree) == expected
    assert tree["ap_bev_r40_50"] is not None


def test_what_is_ignored_is_not_evaluated() -> None:
    boxes = found((10, 0, 0.9), (40, 0, 0.5), (0, 10, 0.4))
    ignored = replace(boxes, is_ignored=np.array([True, True, False]))
    tree = figures(truth((10, 0)), ignored)["car"]
    assert counts(tree) == {"truth": 1, "found": 3, "right": 1, "ignored": 1, "false": 1}


def test_the_wrong_class_is_a_miss_and_a_false_detection() -> None:
    tree = figures(truth((10, 0), (20, 0)), found((10, 0, 0.9), (20, 0, 0.8), class_ids=[1, 0]))
    assert counts(tree["car"]) == {"truth": 2, "found": 1, "right": 1, "missed": 1}
    assert counts(tree["van"]) == {"found": 1, "false": 1}


def test_errors_of_a_turned_object() -> None:
    # it looks to +y and is found 0.3 m ahead, 0.1 m to its left, 0.2 m too high, longer, and turned by 170 degrees
    true = truth_boxes([10, 0, 1, 4, 2, 1.5, np.pi / 2])
    boxes = source_boxes([9.9, 0.3, 1.2, 4.4, 1.9, 1.5, np.pi / 2 + np.radians(170)])
    errors = figures(true, boxes)["car"]["errors"]
    biases = {"along_m": 0.3, "across_m": 0.1, "z_m": 0.2, "length_m": 0.4, "width_m": -0.1, "height_m": 0.0}
    for name, bias in biases.items():
        assert errors[name]["bias"] == pytest.approx(bias, abs=1e-6)
        assert errors[name]["mean"] == pytest.approx(abs(bias), abs=1e-6)
    assert errors["position_bev_m"]["max"] == pytest.approx(np.hypot(0.3, 0.1), abs=1e-6)
    assert errors["heading_deg"]["rmse"] == pytest.approx(170, abs=1e-4)
    assert errors["heading_mod_180_deg"]["p50"] == pytest.approx(10, abs=1e-4)
    assert errors["flips"] == 1.0


def test_ranges_hold_everything_once_and_matches_count_where_the_object_is() -> None:
    true = truth((9.9, 0), (50, 0), (100, 0))
    tree = figures(true, found((10.1, 0, 0.9), (19.9, 0, 0.8), (100, 0, 0.7)))["car"]["ranges"]
    assert list(tree) == ["0_10", "10_20", "20_40", "40_80", "over_80"]
    assert {name: counts(part) for name, part in tree.items()} == {
        "0_10": {"truth": 1, "found": 0 + 1, "right": 1},
        "10_20": {"found": 1, "false": 1},
        "20_40": {},
        "40_80": {"truth": 1, "missed": 1},
        "over_80": {"truth": 1, "found": 1, "right": 1},
    }
    assert (tree["0_10"]["ap_bev_r40_50"], tree["40_80"]["ap_bev_r40_50"]) == (1.0, 0.0)
    assert tree["20_40"]["ap_bev_r40_50"] is None
    assert (tree["40_80"]["from_m"], tree["40_80"]["to_m"], tree["over_80"]["to_m"]) == (40.0, 80.0, None)


def test_zones() -> None:
    zones = [
        Zone("north", np.array([[-99.0, 0.0], [99.0, 0.0], [99.0, 99.0], [-99.0, 99.0]])),
        Zone("everywhere", np.array([[-99.0, -99.0], [99.0, -99.0], [99.0, 99.0], [-99.0, 99.0]])),
    ]
    true = truth((10, 0.2), (10, -8))
    tree = figures(true, found((10, -0.2, 0.9), (0, -30, 0.5), (300, 0, 0.4)), zones=zones)["car"]["zones"]
    assert counts(tree["north"]) == {"truth": 1, "found": 0 + 1, "right": 1}
    assert counts(tree["everywhere"]) == {"truth": 1, "found": 1, "missed": 1, "false": 1}
    assert tree["everywhere"]["recall"] == 0.0


def test_recall_by_label() -> None:
    true = truth((10, 0), (20, 0), (30, 0), labels=["taxi", "car", "car"])
    tree = figures(true, found((20, 0, 0.9), (30, 0, 0.8)))
    for name in ("car", "all"):
        assert tree[name]["labels"] == {
            "car": {"truth": 2, "right": 2, "recall": 1.0},
            "taxi": {"truth": 1, "right": 0, "recall": 0.0},
        }
    assert tree["van"]["labels"] == {}


def test_frames_without_truth_are_counted_and_not_evaluated() -> None:
    boxes = found((10, 0, 0.9))
    frames = [EvaluationFrame(0, 0, None, {"lidar": boxes}), EvaluationFrame(1, 1, truth(), {"lidar": boxes})]
    for name in ("car", "all"):
        tree = evaluated(frames, config())["sources"]["lidar"][name]
        assert (tree["frames"], tree["frames_without_truth"], tree["false"]) == (1, 1, 1)
    tree = evaluated(frames[:1], config())["sources"]["lidar"]["car"]
    assert (tree["frames"], tree["found"], tree["precision"], tree["false_per_frame"]) == (0, 0, None, None)


def test_nothing_at_all() -> None:
    assert evaluated([], config()) == {"sources": {}, "images": {}, "fusion_gain": {}}


def test_frames_matched_together_are_as_if_matched_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    frames = [
        EvaluationFrame(
            row,
            row * 10**8,
            truth(*rng.uniform(-20, 20, (4, 2)), class_ids=rng.integers(0, 2, 4), labels=rng.choice(["a", "b"], 4)),
            {"lidar": found(*np.column_stack([rng.uniform(-20, 20, (5, 2)), rng.random(5)]))},
        )
        for row in range(9)
    ]
    together = evaluated(frames, config())
    for name, limit in (("_MAX_FRAMES", 2), ("_MAX_PAIRS", 1)):
        monkeypatch.setattr(f"lidcam.pipeline.evaluation.detection.gathering.{name}", limit)
        assert evaluated(frames, config()) == together
