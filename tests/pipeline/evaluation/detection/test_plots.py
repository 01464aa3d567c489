"""Counts for plots, against the figures of the evaluation."""

from typing import Any

import numpy as np
from evaluation_frames import frame_of, source_boxes, truth_boxes

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.detection_evaluation import DetectionEvaluation
from lidcam.pipeline.evaluation.detection.plots import DetectionPlots

CONFIG, CAR = Config(), 0
SIZE = (4.0, 1.7, 1.5)


def row(x: float, y: float = 0.0) -> tuple[float, ...]:
    return (x, y, 0.75, *SIZE, 0.0)


def test_without_truth_there_is_nothing_to_plot() -> None:
    plots = DetectionPlots(CONFIG)
    plots.add_frame(frame_of(0, None, {"fused": source_boxes([row(1)])}))
    assert (plots.truth_counts, plots.figures(), len(plots.places.errors_m)) == ({}, {}, 0)


def test_curves_end_where_precision_and_recall_are() -> None:
    chance = np.random.default_rng(1)
    plots, judge = DetectionPlots(CONFIG), DetectionEvaluation(CONFIG, ())
    for index in range(30):
        places = [12.0 * n for n in range(4)]
        found = [x + chance.normal(0, 1.2) for x in places if chance.random() < 0.8] + [100.0] * (chance.random() < 0.5)
        scores = chance.uniform(0, 1, len(found)).tolist()
        truth = truth_boxes([row(x) for x in places], list(range(4)))
        frame = frame_of(index, truth, {"fused": source_boxes([row(x) for x in found], scores=scores)})
        plots.add_frame(frame)
        judge.add_frame(frame)
    tree: Any = judge.figures()
    figures = tree["sources"]["fused"]["car"]
    scores, recall, precision = plots.curve("fused", CAR)
    assert (np.diff(scores) < 0).all()
    np.testing.assert_allclose([recall[-1], precision[-1]], [figures["recall"], figures["precision"]])
    assert plots.truth_counts["fused"][CAR] == len(plots.places.errors_m) == figures["truth"] == 120
    found_m = plots.places.errors_m[~np.isnan(plots.places.errors_m)]
    np.testing.assert_allclose(found_m.mean(), figures["errors"]["position_bev_m"]["mean"], rtol=1e-6)
