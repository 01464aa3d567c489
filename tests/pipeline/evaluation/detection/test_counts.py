"""Scores to choose a threshold from, against every threshold tried out."""

from typing import Any

import numpy as np
import pytest
from evaluation_scenes import boxes3d, evaluated, truth3d
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.counts import calibration_figures, count_figures, threshold_figures
from lidcam.pipeline.evaluation.detection.curves import curve_of
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame


def plain_points(detections: list[tuple[float, bool]], truth: int) -> list[dict[str, float]]:
    points = []
    for threshold in sorted({score for score, _ in detections}, reverse=True):
        reported = [right for score, right in detections if score >= threshold]
        right = sum(reported)
        f1 = 2 * right / (len(reported) + truth)  # the harmonic mean, so that equal ones are equal
        points.append({"score": threshold, "precision": right / len(reported), "recall": right / truth, "f1": f1})
    return points


@given(st.lists(st.tuples(st.integers(0, 16), st.booleans()), max_size=30), st.integers(0, 4))
def test_equal_to_trying_every_threshold(rows: list[tuple[int, bool]], missed: int) -> None:
    detections = sorted(((score / 16, right) for score, right in rows), reverse=True)
    truth = sum(right for _, right in detections) + missed
    scores = np.array([score for score, _ in detections], np.float32)
    curve = curve_of(scores, np.array([right for _, right in detections], np.bool_), truth)
    figures: Any = threshold_figures(curve)
    counts = count_figures(curve, 2, 3)
    points = plain_points(detections, truth) if truth else []
    best = max(points, key=lambda point: point["f1"], default={"f1": 0.0})
    nothing = dict.fromkeys(("score", "precision", "recall", "f1"))
    assert figures["best_f1"] == (pytest.approx(best) if best["f1"] else nothing)
    for precision in (0.5, 0.8, 0.9):
        reached = [point for point in points if point["precision"] >= precision]
        assert figures[f"precision_{100 * precision:.0f}"] == (pytest.approx(reached[-1]) if reached else nothing)
    assert counts["found"] == len(detections) + 2
    assert (counts["ignored"], counts["truth_ignored"]) == (2, 3)
    assert counts["missed"] == missed
    if points:
        assert counts["f1"] == pytest.approx(points[-1]["f1"])
        assert counts["precision"] == pytest.approx(points[-1]["precision"])


def test_thresholds_by_source_and_class() -> None:
    truth = truth3d([[10, 0, 1]], [[4, 2, 1.5]], [0.0], [0])
    found = boxes3d([[10, 0, 1], [30, 0, 1]], np.full((2, 3), (4, 2, 1.5)), [0.0, 0.0], [0.75, 0.5], [0, 0])
    thresholds = evaluated([EvaluationFrame(0, 0, truth, {"lidar": found})], Config())["thresholds"]["lidar"]
    for name in ("car", "all"):
        assert thresholds[name]["best_f1"] == {"score": 0.75, "precision": 1.0, "recall": 1.0, "f1": 1.0}
        assert thresholds[name]["precision_50"]["score"] == 0.5
        assert thresholds[name]["precision_90"]["score"] == 0.75
    assert thresholds["bus"]["precision_50"]["score"] is None


DETECTIONS = st.lists(st.tuples(st.floats(0, 1, width=32), st.booleans()), max_size=60)


@given(DETECTIONS)
def test_calibration_is_equal_to_its_definition(detections: list[tuple[float, bool]]) -> None:
    scores = np.array([score for score, _ in detections], np.float32)
    figures = calibration_figures(scores, np.array([right for _, right in detections], np.bool_))
    gaps, table = [], figures["reliability"]
    assert isinstance(table, list)
    for row in range(10):
        inside = [
            (score, right)
            for score, right in detections
            if row <= 10 * score < row + 1 or (row == 9 and score == 1)  # the last bin holds its upper end
        ]
        assert table[row]["count"] == len(inside)
        if inside:
            mean, share = np.mean([score for score, _ in inside]), np.mean([right for _, right in inside])
            assert table[row]["mean_score"] == pytest.approx(mean, abs=1e-9)
            assert table[row]["right"] == pytest.approx(share, abs=1e-9)
            gaps.append((len(inside), abs(mean - share)))
        else:
            assert table[row]["mean_score"] is table[row]["right"] is None
    if not detections:
        assert figures["ece"] is None
        return
    n = len(detections)
    assert figures["ece"] == pytest.approx(sum(count * gap for count, gap in gaps) / n, abs=1e-9)
