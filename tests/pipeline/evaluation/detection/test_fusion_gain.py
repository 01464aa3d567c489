"""What fusion adds, against figures of recordings that are resampled frame by frame."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evaluation_frames import evaluated, rows_at, source_boxes, truth_boxes

from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.detection.resampling import Resampling
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, figure_at

SIZE_M = (4.0, 2.0, 1.5)
CLASSES = tuple(ClassPrior(name=name, size_m=SIZE_M, max_size_m=(9.0, 9.0, 9.0)) for name in ("car", "bus"))
CONFIG = Config(classes=CLASSES, evaluate=EvaluateConfig(iou=(0.5,)))
FIGURES = ("ap_bev_r40_50", "ap_3d_r40_50", "precision", "recall", "f1", "errors.position_bev_m.mean")
SOURCES = ("fused", "lidar")
PERIOD_NS = 250_000_000


@pytest.fixture(autouse=True)
def _few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.pipeline.evaluation.detection.resampling.SAMPLES", 20)


def drive(frames: int, noise_m: dict[str, float], seed: int = 0) -> list[EvaluationFrame]:
    """Frames of a quarter of a second with some objects; each source places them with its own noise."""
    rng = np.random.default_rng(seed)
    made = []
    for index in range(frames):
        n = int(rng.integers(1, 5))
        ids, centers, yaws = rng.integers(0, 2, n), rng.uniform(-30, 30, (n, 3)) * (1, 1, 0.01), rng.uniform(-3, 3, n)
        sources = {}
        for name, noise in noise_m.items():
            rows, false = np.flatnonzero(rng.random(n) < 0.85), int(rng.integers(0, 3))
            places = np.r_[centers[rows] + rng.normal(0, noise, (len(rows), 3)), rng.uniform(-30, 30, (false, 3))]
            sizes = np.full((len(places), 3), SIZE_M)
            turned = np.r_[yaws[rows] + rng.normal(0, 0.1, len(rows)), np.zeros(false)]
            sources[name] = source_boxes(
                np.c_[places, sizes, turned],
                # all different, or the order of repeated frames would matter by distance
                scores=(np.r_[rng.beta(5, 2, len(rows)), rng.beta(2, 4, false)] + 1) / 2,
                class_ids=np.r_[ids[rows], rng.integers(0, 2, false)],
            )
        truth = truth_boxes(np.c_[centers, np.full((n, 3), SIZE_M), yaws], class_ids=ids)
        made.append(EvaluationFrame(index, index * PERIOD_NS, truth, sources))
    return made


def only(source: str, frames: list[EvaluationFrame]) -> list[EvaluationFrame]:
    return [replace(frame, sources={source: frame.sources[source]}) for frame in frames]


def test_equal_to_recordings_put_together_from_the_drawn_blocks() -> None:
    frames = drive(20, {"lidar": 0.4, "fused": 0.2})
    figures = evaluated(frames, CONFIG)
    drawn = Resampling.of(np.array([frame.stamp_ns for frame in frames]))
    assert drawn.block_count == 5
    assert drawn.blocks.tolist() == [frame.stamp_ns // 10**9 for frame in frames]
    assert (drawn.weights.sum(1) == 5).all()
    samples = []
    for weights in drawn.weights:
        rows = np.repeat(np.arange(len(frames)), weights[drawn.blocks].astype(int))
        samples.append({name: evaluated(only(name, [frames[row] for row in rows]), CONFIG) for name in SOURCES})
    for class_name in ("car", "bus", "all"):
        for name in FIGURES:
            gain = figure_at(figures["fusion_gain"][class_name], name)
            sign = -1 if name.startswith("errors") else 1
            values = {
                source: [figure_at(sample[source]["sources"][source][class_name], name) for sample in samples]
                for source in SOURCES
            }
            low, high = np.percentile(sign * np.subtract(values["fused"], values["lidar"]), [2.5, 97.5])
            assert gain["low"] == pytest.approx(low, abs=1e-6), (class_name, name)
            assert gain["high"] == pytest.approx(high, abs=1e-6), (class_name, name)
            fused, lidar = (figure_at(figures["sources"][source][class_name], name) for source in SOURCES)
            assert gain["value"] == pytest.approx(sign * (fused - lidar), abs=1e-12)
            assert (gain["fused"], gain["over"]) == (fused, "lidar")


def test_fusion_that_takes_away_is_said_so() -> None:
    worse = evaluated(drive(80, {"lidar": 0.1, "fused": 1.0}), CONFIG)["fusion_gain"]
    better = evaluated(drive(80, {"lidar": 1.0, "fused": 0.1}), CONFIG)["fusion_gain"]
    for name in ("ap_bev_r40_50", "errors.position_bev_m.mean"):
        assert figure_at(worse["all"], name)["high"] < 0
        assert figure_at(worse["all"], name)["takes_away"] is True
        assert figure_at(better["all"], name)["low"] > 0
        assert figure_at(better["all"], name)["takes_away"] is False


def test_what_differs_by_rounding_alone_is_no_gain() -> None:
    frames = drive(80, {"lidar": 0.4})
    random = np.random.default_rng(4)
    for row, frame in enumerate(frames):
        boxes = frame.sources["lidar"].boxes
        scores = boxes.scores[random.permutation(len(boxes))]  # the same errors, summed in another order
        fused = replace(frame.sources["lidar"], boxes=replace(boxes, scores=scores))
        frames[row] = replace(frame, sources={**frame.sources, "fused": fused})
    gain = evaluated(frames, CONFIG)["fusion_gain"]["all"]["errors"]["position_bev_m"]["mean"]
    assert (gain["value"], gain["low"], gain["high"], gain["takes_away"]) == (0.0, 0.0, 0.0, False)


def test_nothing_to_compare() -> None:
    assert evaluated(drive(4, {"lidar": 0.1}), CONFIG)["fusion_gain"] == {}
    assert evaluated(drive(4, {"fused": 0.1}), CONFIG)["fusion_gain"] == {}
    assert evaluated([], CONFIG)["fusion_gain"] == {}


def gain_of(lidar_m: list[float | None], fused_m: list[float | None], *, frames: int = 1) -> Any:
    """Of cars 20 m from each other, each found so far off, or not at all."""

    def found(off_m: list[float | None]) -> Any:
        return source_boxes(rows_at([(20.0 * row, one) for row, one in enumerate(off_m) if one is not None]))

    truth = truth_boxes(rows_at([(0, 0), (20, 0), (40, 0)]))
    sources = {"lidar": found(lidar_m), "fused": found(fused_m)}
    made = [EvaluationFrame(index, index * 10**9, truth, sources) for index in range(frames)]
    return evaluated(made, CONFIG)["fusion_gain"]


def test_only_the_objects_that_both_found_are_the_same_objects() -> None:
    found = gain_of([0.1, None, 0.4], [0.3, 1.0, 0.2])
    assert found["car"]["errors"]["position_bev_m"]["mean"]["value"] == pytest.approx(0.25 - 0.5)
    same = {"objects": 2, "value": pytest.approx(0.0, abs=1e-6), "low": None, "high": None, "takes_away": None}
    assert found["car"]["same_objects"] == {"lidar": same}
    assert found["all"]["same_objects"]["lidar"] == same
    nothing = gain_of([0.1, None, None], [None, 0.1, None])["car"]["same_objects"]["lidar"]
    assert nothing == {"objects": 0, "value": None, "low": None, "high": None, "takes_away": None}
