"""What must not change figures, and what must."""

from dataclasses import replace
from typing import Any

import numpy as np
from evaluation_scenes import boxes3d, evaluated, truth3d
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, SourceBoxes

CONFIG = Config(evaluate=EvaluateConfig(bootstrap=100, ranges_m=(0, 1000)))
SEEDS = st.integers(0, 2**32 - 1)
SIZE_M = np.array([4.0, 1.7, 1.55])


def frame(seed: int) -> EvaluationFrame:
    """Some cars and buses, most of them found, of scores that are all different."""
    rng = np.random.default_rng(seed)
    n, false = int(rng.integers(1, 8)), int(rng.integers(0, 5))
    ids, centers, yaws = rng.choice([0, 4], n), rng.uniform(-15, 15, (n, 3)) * (1, 1, 0), rng.uniform(-3, 3, n)
    rows = np.flatnonzero(rng.random(n) < 0.8)
    found = boxes3d(
        np.concatenate([rng.normal(centers[rows], (0.3, 0.3, 0.1)), rng.uniform(-15, 15, (false, 3)) * (1, 1, 0)]),
        np.full((len(rows) + false, 3), SIZE_M),
        rng.uniform(-3, 3, len(rows) + false),
        (rng.permutation(len(rows) + false) + 1) / 32,
        np.concatenate([ids[rows], rng.choice([0, 4], false)]),
    )
    return EvaluationFrame(0, 0, truth3d(centers, np.full((n, 3), SIZE_M), yaws, ids), {"lidar": found})


def figures(shown: EvaluationFrame) -> Any:
    return evaluated([shown], CONFIG)["sources"]["lidar"]


def with_boxes(shown: EvaluationFrame, **columns: Any) -> EvaluationFrame:
    boxes = replace(shown.sources["lidar"].boxes, **columns)
    return replace(shown, sources={"lidar": SourceBoxes(boxes, np.full(len(boxes), -1, np.int64))})


def changed_figures(before: Any, after: Any, tolerance: float = 1e-9) -> set[str]:
    """Names of the figures that differ by more than rounding; lists are left out."""
    first, second = leaves(before), leaves(after)
    assert list(first) == list(second)
    return {
        name
        for name, value in first.items()
        if not isinstance(value, list)
        and (
            (value is None) != (second[name] is None)
            or (value is not None and abs(second[name] - value) > tolerance * (1 + abs(value)))
        )
    }


def leaves(tree: Any, left_out: tuple[str, ...] = (), beginning: str = "") -> dict[str, Any]:
    """All figures by name, without those of the given last names."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            found |= leaves(value, left_out, f"{beginning}{name}.")
        elif name not in left_out:
            found[f"{beginning}{name}"] = value
    return found


@settings(max_examples=8)
@given(seed=SEEDS)
def test_the_order_in_a_frame_does_not_matter(seed: int) -> None:
    shown = frame(seed)
    assert shown.truth is not None
    rng = np.random.default_rng(seed)
    turned = replace(
        shown,
        truth=shown.truth.select(rng.permutation(len(shown.truth))),
        sources={"lidar": shown.sources["lidar"].select(rng.permutation(len(shown.sources["lidar"])))},
    )
    assert not changed_figures(figures(shown), figures(turned))


@settings(max_examples=8)
@given(seed=SEEDS)
def test_scores_matter_by_their_order_alone(seed: int) -> None:
    shown = frame(seed)
    changed = with_boxes(shown, scores=(shown.sources["lidar"].boxes.scores ** 2).astype(np.float32))
    # nuScenes reads its errors at scores between those of detections
    of_errors = ("translation_m", "scale", "orientation_deg", "score")
    of_scores = ("best_f1_score", "ece", "mce", "brier", *of_errors)
    differing = changed_figures(figures(shown), figures(changed))
    assert {name for name in differing if name.rpartition(".")[2] not in of_scores} == set()


@settings(max_examples=8)
@given(seed=SEEDS, count=st.integers(0, 3))
def test_what_is_ignored_changes_only_counts_of_the_ignored(seed: int, count: int) -> None:
    shown = frame(seed)
    truth, boxes = shown.truth, shown.sources["lidar"].boxes
    assert truth is not None
    place = np.array([[200.0, 0.0, 0.0]])
    ignored = truth3d(place, SIZE_M[None], [0.5], [0], is_ignored=[True], labels=["ignored"])
    there = boxes3d(
        np.repeat(place, count, 0), np.tile(SIZE_M, (count, 1)), np.zeros(count), np.ones(count), [0] * count
    )
    all_boxes = join_rows(boxes, there.boxes)
    found = {"lidar": SourceBoxes(all_boxes, np.full(len(all_boxes), -1, np.int64))}
    changed = replace(shown, truth=join_rows(truth, ignored), sources=found)
    of_ignored = ("truth_ignored", "found", "ignored")
    before, after = figures(shown), figures(changed)
    assert leaves(after, of_ignored) == leaves(before, of_ignored)
    assert after["all"]["truth_ignored"] == before["all"]["truth_ignored"] + 1
    assert after["all"]["ignored"] == before["all"]["ignored"] + count


@settings(max_examples=8)
@given(seed=SEEDS)
def test_a_moved_site_keeps_errors_and_precision(seed: int) -> None:
    shown = frame(seed)
    assert shown.truth is not None
    by_m = np.array([3.0, -2.0, 1.0])
    moved = with_boxes(
        replace(shown, truth=replace(shown.truth, centers=shown.truth.centers + by_m)),
        centers=shown.sources["lidar"].boxes.centers + by_m,
    )
    assert not changed_figures(figures(shown), figures(moved), tolerance=1e-5)
