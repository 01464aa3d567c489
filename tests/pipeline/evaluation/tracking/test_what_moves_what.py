"""Each mistake moves the figures that it should, and no other."""

from collections.abc import Callable
from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
import pytest
from evaluation_frames import frame_of, source_boxes, truth_boxes

from pipeline.core.settings.config import Config
from pipeline.evaluation.records import EvaluationFrame, SourceBoxes
from pipeline.evaluation.tracking.evaluation import TrackingEvaluation

FRAMES, MISTAKE = 10, 5
CAR = (4.0, 1.7, 1.5)
SHIFT_M = np.array([0.06, 0.08, 0.0])

BY_SIMILARITY = {
    f"{name}{end}"
    for name in ("hota", "det_a", "ass_a", "det_re", "det_pr", "ass_re", "ass_pr", "loc_a")
    for end in ("", "_iou")
}
RATES = {"mota", "recall", "precision", "idf1", "idp", "idr", "amota"}
LENGTHS = {"track_frames_mean", "track_frames_median", "track_s_mean", "track_s_median"}


def perfect() -> list[EvaluationFrame]:
    """Two cars side by side, found where they are."""
    frames = []
    for k in range(FRAMES):
        rows = [[k, y, 0.8, *CAR, 0.0] for y in (0.0, 5.0)]
        frames.append(frame_of(k, truth_boxes(rows, [1, 2]), {"fused": source_boxes(rows, [1, 2])}))
    return frames


def figures(change: Callable[[SourceBoxes, int], SourceBoxes]) -> dict[str, Any]:
    evaluation = TrackingEvaluation(Config())
    for frame in perfect():
        evaluation.add(replace(frame, sources={"fused": change(frame.sources["fused"], frame.index)}))
    tree: Any = evaluation.figures()
    car: dict[str, Any] = dict(tree["tracking"]["fused"]["car"])
    averages: dict[str, Any] = car.pop("distance")
    return car | averages


def same(found: SourceBoxes, _: int) -> SourceBoxes:
    return found


def killed(found: SourceBoxes, frame: int) -> SourceBoxes:
    return found.select(np.array([1])) if frame == MISTAKE else found


def doubled(found: SourceBoxes, frame: int) -> SourceBoxes:
    return replace(found.select(np.array([0, 1, 1])), track_ids=np.array([1, 2, 3])) if frame == MISTAKE else found


def turned(found: SourceBoxes, frame: int) -> SourceBoxes:
    yaws = np.array([pi, 0.0]) if frame == MISTAKE else found.boxes.yaws
    return replace(found, boxes=replace(found.boxes, yaws=yaws))


def shifted(found: SourceBoxes, _: int) -> SourceBoxes:
    return replace(found, boxes=replace(found.boxes, centers=found.boxes.centers + SHIFT_M))


def swapped(found: SourceBoxes, frame: int) -> SourceBoxes:
    return replace(found, track_ids=found.track_ids[::-1].copy()) if frame >= MISTAKE else found


def relabelled(found: SourceBoxes, frame: int) -> SourceBoxes:
    class_ids = np.array([3, 0], np.int32)
    return replace(found, boxes=replace(found.boxes, class_ids=class_ids)) if frame == MISTAKE else found


@pytest.mark.parametrize(
    ("change", "moved"),
    [
        (same, set()),
        (
            killed,
            (BY_SIMILARITY - {"det_pr", "det_pr_iou", "ass_pr", "ass_pr_iou", "loc_a", "loc_a_iou"})
            | (RATES - {"precision", "idp"})
            | {"misses", "fragmentations", "track_frames_mean", "track_frames_median", "amotp_m"},
        ),
        (
            doubled,
            {"hota", "hota_iou", "det_a", "det_a_iou", "det_pr", "det_pr_iou"}
            | {"mota", "amota", "precision", "idf1", "idp", "false_positives", "found_tracks"}
            | {"track_frames_mean", "track_s_mean"},
        ),
        (turned, {"heading_flips"}),
        # An IoU is below 0.95 then, and so nothing is matched at that threshold; the centres are at 0.95.
        (shifted, {"loc_a", "motp_m", "amotp_m", *(name for name in BY_SIMILARITY if name.endswith("_iou"))}),
        (
            swapped,
            {"hota", "hota_iou", "ass_a", "ass_a_iou", "ass_re", "ass_re_iou", "ass_pr", "ass_pr_iou"}
            | {"mota", "idf1", "idp", "idr", "id_switches", "amota", "amotp_m"},
        ),
        (
            relabelled,
            (BY_SIMILARITY - {"det_pr", "det_pr_iou", "ass_pr", "ass_pr_iou", "loc_a", "loc_a_iou"})
            | (RATES - {"precision", "idp"})
            | {"misses", "fragmentations", "track_frames_mean", "track_frames_median", "amotp_m"},
        ),
    ],
)
def test_a_mistake_moves_its_figures(change: Callable[[SourceBoxes, int], SourceBoxes], moved: set[str]) -> None:
    before, after = figures(same), figures(change)
    assert {name for name in before if after[name] != pytest.approx(before[name])} == moved
