"""Each fault moves the figures that are about it and no other: a simulated run without an error, then spoiled."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from lidcam.evaluation.evaluators import evaluators_of, measure
from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.core.arrays import Indices
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, SourceBoxes
from lidcam.readers.results.result import open_result
from lidcam.readers.truth.open import open_truth

ROOT = Path(__file__).resolve().parents[3]
FRAME = 6
"""The frame that is spoiled, or from which on."""

CAR = 0
ROUNDING = 1e-4

RANKED = {"ap_bev", "ap_3d", "distance.ap", "distance.map"}
SCORES = {"calibration.ece", "calibration.reliability"}
FOUND = {*RANKED, *SCORES, "found", "f1"}


def tracks(*names: str) -> set[str]:
    return {f"track {name}" for name in names}


TABLE = {
    "a match is lost": {
        *FOUND,
        *("right", "missed", "recall", "labels"),
        *tracks("hota", "ass_a", "ass_re", "det_a", "det_re"),
        *tracks("mota", "idf1", "idr", "recall", "misses", "fragmentations"),
    },
    "a heading is turned round": {
        *("errors.heading_deg", "errors.flips", "errors.flips_moving"),
        *tracks("heading_flips"),
    },
    "all boxes are 10 cm off": {
        *("errors.position_bev_m", "errors.along_m", "errors.across_m"),
        *tracks("motp_m", "loc_a"),
    },
    "an object is doubled": {
        *FOUND,
        *("false", "false_per_frame", "precision"),
        *tracks("hota", "det_a", "det_pr"),
        *tracks("mota", "idf1", "idp", "precision", "false_positives", "found_tracks"),
        *tracks("false_tracks", "false_track_s_mean"),
    },
    "two ids are swapped": {
        *tracks("hota", "ass_a", "ass_re", "ass_pr"),
        *tracks("id_switches", "mota", "idf1", "idp", "idr"),
    },
}
"""What each fault moves of the figures of cars; `family` says which figures belong together."""


def family(name: str) -> str:
    """A figure without source, class, slice, statistic and threshold: `ap_bev` of `ap_bev_r40_50`."""
    section, _, _, figure = name.split(".", 3)
    figure = re.sub(r"^(ranges|zones)\.[^.]+\.", "", figure)
    figure = re.sub(r"^(errors\.[^.]+|calibration\.reliability|labels)\..*$", r"\1", figure)
    figure = re.sub(r"_r40_\d+$|(?<=distance\.ap)_.*$", "", figure)
    return f"track {figure}" if section == "tracking" else figure


@cache
def scene() -> tuple[Config, Rig, tuple[EvaluationFrame, ...]]:
    """A simulated run whose fused objects are the true ones, with their ids, each with a score of its own."""
    with (
        open_result(ROOT / "tests" / "golden" / "crossing.mcap") as result,
        open_truth(result, [ROOT / "bags" / "crossing.mcap"]) as truth,
    ):
        frames = tuple(map(without_error, EvaluationFrames(result, truth)))
        return result.config, result.rig, frames


def without_error(frame: EvaluationFrame) -> EvaluationFrame:
    assert frame.truth is not None
    n = len(frame.truth)
    boxes = Boxes3D(
        frame.stamp_ns,
        frame.truth.frame_id,
        frame.truth.centers.copy(),
        frame.truth.sizes.copy(),
        frame.truth.yaws.copy(),
        np.linspace(0.95, 0.55, n).astype(np.float32),
        frame.truth.class_ids.copy(),
        np.zeros(n, np.int32),
        np.zeros((n, 3, 3)),
        np.zeros(n, np.uint8),
        np.full(n, frame.stamp_ns, np.int64),
    )
    return replace(frame, sources={"fused": SourceBoxes(boxes, frame.truth.track_ids.copy())}, images={})


def figures(frames: Sequence[EvaluationFrame]) -> NamedFigures:
    config, rig, _ = scene()
    return NamedFigures(measure(frames, evaluators_of(config, rig)))


def with_fused(frame: EvaluationFrame, fused: SourceBoxes) -> EvaluationFrame:
    return replace(frame, sources={"fused": fused})


def cars(frame: EvaluationFrame) -> Indices:
    """Cars that are there from the first frame to the last and count."""
    assert frame.truth is not None
    return np.flatnonzero((frame.truth.class_ids == CAR) & (frame.truth.lidar_points > 0))


def lost(frame: EvaluationFrame) -> EvaluationFrame:
    fused = frame.sources["fused"]
    return with_fused(frame, fused.select(np.flatnonzero(np.arange(len(fused)) != cars(frame)[1])))


def turned_round(frame: EvaluationFrame) -> EvaluationFrame:
    fused = frame.sources["fused"]
    yaws = fused.boxes.yaws.copy()
    yaws[cars(frame)[1]] += np.pi
    return with_fused(frame, SourceBoxes(replace(fused.boxes, yaws=wrap_angle(yaws)), fused.track_ids))


def off(frame: EvaluationFrame) -> EvaluationFrame:
    fused = frame.sources["fused"]
    boxes = replace(fused.boxes, centers=fused.boxes.centers + np.array([0.1, 0.0, 0.0]))
    return with_fused(frame, SourceBoxes(boxes, fused.track_ids))


def doubled(frame: EvaluationFrame) -> EvaluationFrame:
    fused = frame.sources["fused"]
    fused = fused.select(np.append(np.arange(len(fused)), cars(frame)[1]))
    ids = fused.track_ids.copy()
    ids[-1] = ids.max() + 1
    return with_fused(frame, SourceBoxes(fused.boxes, ids))


def swapped(frame: EvaluationFrame) -> EvaluationFrame:
    fused, (first, second) = frame.sources["fused"], cars(scene()[2][FRAME])[1:3]
    ids = fused.track_ids.copy()
    ids[[first, second]] = ids[[second, first]]
    return with_fused(frame, SourceBoxes(fused.boxes, ids))


def spoiled(fault: str) -> list[EvaluationFrame]:
    faults: dict[str, tuple[Callable[[EvaluationFrame], EvaluationFrame], range]] = {
        "a match is lost": (lost, range(FRAME, FRAME + 1)),
        "a heading is turned round": (turned_round, range(FRAME, FRAME + 1)),
        "all boxes are 10 cm off": (off, range(1000)),
        "an object is doubled": (doubled, range(FRAME, FRAME + 1)),
        "two ids are swapped": (swapped, range(FRAME, 1000)),
    }
    change, which = faults[fault]
    return [change(frame) if number in which else frame for number, frame in enumerate(scene()[2])]


@cache
def without_fault() -> NamedFigures:
    return figures(scene()[2])


def moved(fault: str) -> list[str]:
    """Names of the figures against truth that the fault moves."""
    sound, found = without_fault(), figures(spoiled(fault))
    names = [name for name in sound if name.startswith(("sources.", "tracking."))]
    return [name for name in names if not same(sound[name], found.get(name))]


def same(first: object, second: object) -> bool:
    if isinstance(first, int | float) and isinstance(second, int | float):
        return abs(first - second) <= ROUNDING * max(1.0, abs(first))
    return first == second


def test_a_run_without_error_has_the_best_figures() -> None:
    sound = without_fault()
    best = ("recall", "precision", "ap_bev_r40_70", "ap_3d_r40_70", "distance.map")
    assert {name: sound[f"fused.car.{name}"] for name in best} == dict.fromkeys(best, pytest.approx(1.0))
    tracks = {name: sound[f"tracking.fused.car.{name}"] for name in ("hota", "mota", "idf1", "id_switches")}
    assert tracks == {"hota": pytest.approx(1.0), "mota": 1.0, "idf1": 1.0, "id_switches": 0}
    assert sound["fused.car.errors.position_bev_m.max"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("fault", TABLE)
def test_a_fault_moves_what_is_about_it_and_no_other(fault: str) -> None:
    names = moved(fault)
    of_cars = {family(name) for name in names if ".fused.car." in name}
    assert of_cars == TABLE[fault]
    if fault != "all boxes are 10 cm off":
        assert {name.split(".")[2] for name in names} == {"car", "all"}
