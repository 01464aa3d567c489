"""Fit the coefficients of the belief anew, from recordings whose truth is known.

    python benchmarks/measured/belief_fit.py RECORDING[,MODEL.onnx] ... [--check RECORDING ...]

A recording brings its own truth, and 2D boxes or images for a 2D network. `--set` changes settings of the runs. All
coefficients but `in_view` belong to the geometric score (`--set detect3d.method=cluster`); that one belongs to engines
whose scores are probabilities (`--only in_view`).

Each is processed with every threshold on scores open. A hypothesis is right if it lies within 2 m, scaled, of a true
object of its class that no better one shows (docs/figures.md). Twice: as the cameras and the lidars weighed it, and the
lidars' boxes by themselves, which is what frames without images have. The coefficients minimise the cross-entropy, each
recording counting the same, with a weak pull towards those in use; what is learned during a run is learned anew with
each try. Printed are the coefficients, the cross-entropy, the expected calibration error by class, and what thresholds
from 0.2 to 0.6 would find of what is there, and what false objects.

The coefficients in use were fitted to simulated recordings (6 s of `crossing` and `vehicle`, 10 s of `sandbox`; 2D
boxes of the simulator) and five labelled frames of KITTI (2D boxes of YOLOX-nano), each of the four with the same
weight. The expected calibration error of a class is 0.00 to 0.02 (crossing), 0.02 to 0.09 (vehicle), 0.03 (sandbox),
0.00 to 0.18 (KITTI); of 769, 851, 200 and 9 right hypotheses a threshold of 0.5 finds 750, 810, 200 and 9, with 2, 38,
0 and 0 false ones. `match_score`, `match_iou` and `further` are at the limits of the fit: one simulated detector finds
more, and is surer and more exact, than networks. Of 0, -1, -1.5 and -2, `in_view` is best
at -2 for 35 labelled frames of KITTI with YOLOX-nano and the network `traffic`, and at -1 for the simulated recordings,
with little loss at -2; most false people of the real frames are one post, seen in five frames, and unlabelled people
far away.
"""

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.core.arrays import F64, I32, U8, Bools
from lidcam.pipeline.core.association import class_agreement
from lidcam.pipeline.core.detections import Boxes3D, Hypotheses
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.counts import calibration_figures
from lidcam.pipeline.evaluation.detection.criteria import Criteria
from lidcam.pipeline.evaluation.detection.gathering import Gathering
from lidcam.pipeline.evaluation.detection.tables import IGNORED
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, SourceBoxes, TruthBoxes3D
from lidcam.pipeline.fusion.belief.memory import RecallCounts
from lidcam.pipeline.fusion.belief.odds import (
    FITTED,
    Coefficients,
    camera_evidence,
    joined,
    joined_without_each,
    log_odds_before_cameras,
    match_radii_m,
    position_probability,
    probability,
    view_shares,
)
from lidcam.pipeline.fusion.belief.visibility import Visibility, find_visibility
from lidcam.processing import RunObserver, process_recording
from lidcam.readers.results.result import open_result
from lidcam.readers.truth.open import open_truth
from lidcam.run.build import decided
from lidcam.run.frames import RunInput
from lidcam.run.job import make_job

OPEN = ("fuse.min_score=0.0", "track.mode=none", "output.images=false", "output.clouds=false")

PULL = 1e-4  # weight of the squared distance from the coefficients in use
MIN_PROBABILITY = 1e-3  # no probability is taken to be nearer to 0 or 1
ROUNDS = 3  # labels and what is learned during a run depend on the coefficients, and are made anew in each

LIMITS = {"match_score": (0.3, 1.5), "match_iou": (2.0, 6.0), "further": (0.3, 0.8)}
"""Recordings of one network and one simulator may not say more: others find less, and are less sure and less exact."""


@dataclass(frozen=True, eq=False)
class WeighedFrame:
    """The boxes weighed in one frame: with the cameras, and the lidars' boxes alone."""

    boxes: Boxes3D
    lidar_count: int
    visibility: Visibility
    alone: Boxes3D
    truth: TruthBoxes3D


@dataclass(frozen=True, eq=False)
class Weighed:
    """A recording with its truth."""

    name: str
    config: Config
    cameras: tuple[str, ...]
    frames: list[WeighedFrame]

    @cached_property
    def starts(self) -> "list[tuple[Start, Start]]":
        """By frame, the evidence before a camera is asked, of the hypotheses and of the lidars' boxes by themselves."""
        prior = RecallCounts(self.cameras)
        seen = [view_shares(one.visibility, prior.plain(one.visibility)).max(1, initial=0.0) for one in self.frames]
        return [
            (
                Start.of(self.config, one.boxes, one.lidar_count, shares),
                Start.of(self.config, one.alone, len(one.alone), np.zeros((2, len(one.alone)))),
            )
            for one, shares in zip(self.frames, seen, strict=True)
        ]


class Collector(RunObserver):
    """Keeps what is weighed in each frame."""

    def __init__(self) -> None:
        self.frames: list[tuple[Hypotheses, Visibility, Boxes3D]] = []
        self.source: RunInput

    def opened(self, source: RunInput) -> None:  # noqa: D102
        self.source = source

    def frame(self, result: FrameResult) -> None:  # noqa: D102
        agreement = class_agreement(self.source.config.classes)
        cameras, views = result.detections.cameras, result.views
        found = find_visibility(result.hypotheses, cameras, views, result.combined, agreement)
        self.frames.append((result.hypotheses, found, result.detections.lidar))


def weighed(given: str, folder: Path, settings: Sequence[str]) -> Weighed:
    """Process what was given on the command line, and find its truth."""
    path, _, model = given.partition(",")
    collector = Collector()
    result = folder / "result.mcap"
    job = make_job(
        path, result, settings=[*OPEN, *settings], model_2d=Path(model) if model else None, workers=1, overwrite=True
    )
    process_recording(job, collector)
    frames = []
    with open_result(result) as opened, open_truth(opened) as found:
        evaluated = zip(EvaluationFrames(opened, found), collector.frames, strict=True)
        for frame, (hypotheses, visibility, alone) in evaluated:
            if frame.truth is not None:
                frames.append(WeighedFrame(hypotheses.boxes, hypotheses.lidar_count, visibility, alone, frame.truth))
        config = decided(opened.config, opened.rig)
        return Weighed(path, config, tuple(camera.name for camera in opened.rig.cameras), frames)


def probabilities(run: Weighed, by: Coefficients, known: Sequence[F64] = ()) -> tuple[list[F64], list[F64], list[F64]]:
    """By frame: those of the hypotheses, of the lidars' boxes by themselves, and the recall, learned unless known."""
    recall = RecallCounts(run.cameras)
    together, alone, learned = [], [], []
    for row, (frame, (first, second)) in enumerate(zip(run.frames, run.starts, strict=True)):
        before = first.log_odds(by)
        learned.append(known[row] if known else recall.plain(frame.visibility))
        evidence = camera_evidence(frame.visibility, learned[-1], by)
        if not known:
            recall.learn(frame.visibility, probability(before + joined_without_each(evidence, by)))
        together.append(probability(before + joined(evidence, by)) * first.place)
        alone.append(probability(second.log_odds(by)) * second.place)
    return together, alone, learned


@dataclass(frozen=True, eq=False)
class Start:
    """The evidence about boxes before a camera is asked, side by side."""

    scores: F64
    frequencies: F64
    point_counts: I32
    sources: U8
    is_lidar: Bools
    place: F64
    in_view: F64 | None
    are_upright: Bools

    @classmethod
    def of(cls, config: Config, boxes: Boxes3D, lidar_count: int, in_view: F64) -> "Start":
        """Start from the boxes of a frame, how many of them the lidars found, and how well a camera sees each."""
        frequencies = np.array([prior.frequency for prior in config.classes])
        upright = np.array([prior.is_upright for prior in config.classes])
        return cls(
            boxes.scores.astype(np.float64),
            frequencies[boxes.class_ids],
            boxes.point_counts,
            boxes.sources,
            np.arange(len(boxes)) < lidar_count,
            position_probability(boxes.covariances, match_radii_m(config.classes)[boxes.class_ids]),
            in_view * config.detect3d.has_network if config.detect3d.scores_are_probabilities else None,
            upright[boxes.class_ids],
        )

    def log_odds(self, by: Coefficients) -> F64:
        """(N,) as these coefficients say."""
        measured = self.scores, self.frequencies, self.point_counts, self.sources, self.is_lidar
        return log_odds_before_cameras(*measured, by, in_view=self.in_view, are_upright=self.are_upright)


def labels(run: Weighed, found: tuple[list[F64], list[F64]]) -> tuple[F64, F64]:
    """1 for what is right, 0 for what is false, NaN for what is ignored: of all hypotheses, of all lidar boxes."""
    gathering = Gathering(run.config, ())
    for index, (frame, together, alone) in enumerate(zip(run.frames, *found, strict=True)):
        sources = {"fused": _source(frame.boxes, together), "lidar": _source(frame.alone, alone)}
        gathering.add_frame(EvaluationFrame(index, index, frame.truth, sources))
    row = Criteria.of(run.config).position_column
    tables = gathering.found()
    fused, alone = (
        np.where(found == IGNORED, np.nan, (found >= 0).astype(np.float64))
        for found in (tables[name].matches[:, row] for name in ("fused", "lidar"))
    )
    return fused, alone


def _source(boxes: Boxes3D, p: F64) -> SourceBoxes:
    return SourceBoxes(replace(boxes, scores=p.astype(np.float32)), np.full(len(boxes), UNKNOWN, np.int64))


def cross_entropy(probabilities: F64, right: F64) -> float:
    """Mean over what is not ignored."""
    kept = ~np.isnan(right)
    p = np.clip(probabilities[kept], MIN_PROBABILITY, 1 - MIN_PROBABILITY)
    return float(-(right[kept] * np.log(p) + (1 - right[kept]) * np.log(1 - p)).mean()) if kept.any() else 0.0


def fit(runs: Sequence[Weighed], start: Coefficients, only: Sequence[str]) -> Coefficients:
    """The coefficients that describe these runs best; `only` names those that may change, none: all."""
    names = start._fields
    first = np.array(start)
    by = start
    for _ in range(ROUNDS):
        found = [probabilities(run, by) for run in runs]
        known = [(run, one[2], labels(run, one[:2])) for run, one in zip(runs, found, strict=True)]

        def loss(values: F64, known: list[tuple[Weighed, list[F64], tuple[F64, F64]]] = known) -> float:
            tried = Coefficients(*values.tolist())
            total = PULL * float(((values - first) ** 2).sum())
            for run, learned, right in known:
                parts = zip(probabilities(run, tried, learned), right, strict=False)
                total += sum(cross_entropy(np.concatenate(part), is_right) for part, is_right in parts)
            return total

        limits = [
            LIMITS.get(name, (None, None)) if not only or name in only else (value, value)
            for name, value in zip(names, start, strict=True)
        ]
        by = Coefficients(*minimize(loss, np.array(by), method="L-BFGS-B", bounds=limits).x.tolist())
    return by


def report(runs: Sequence[Weighed], by: Coefficients) -> None:
    """Print what the coefficients come to, by recording and class."""
    for run in runs:
        together, alone, _ = probabilities(run, by)
        boxes = [frame.boxes for frame in run.frames], [frame.alone for frame in run.frames]
        whats, found_by, rights = ("weighed", "lidars alone"), (together, alone), labels(run, (together, alone))
        for what, found, right, of_frames in zip(whats, found_by, rights, boxes, strict=True):
            p, ids = np.concatenate(found), np.concatenate([one.class_ids for one in of_frames])
            kept = ~np.isnan(right)
            line = [f"{Path(run.name).name:16} {what:12} {cross_entropy(p, right):.3f}"]
            for class_id, name in enumerate(run.config.class_names):
                rows = kept & (ids == class_id)
                if rows.any():
                    error = calibration_figures(p[rows].astype(np.float32), right[rows] > 0)["ece"]
                    line.append(f"{name} {error:.3f} of {rows.sum()}")
            for limit in (0.2, 0.3, 0.4, 0.5, 0.6):
                over = right[kept & (p >= limit)]
                line.append(f"{limit}: {int((over > 0).sum())}/{int((right > 0).sum())} +{int((over == 0).sum())}")
            print("  ".join(line))


def main() -> None:
    """Process, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", metavar="RECORDING[,MODEL]")
    parser.add_argument("--check", nargs="*", default=[], help="recordings that are reported and not fitted to")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the runs")
    parser.add_argument("--only", action="append", default=[], metavar="COEFFICIENT", help="fit this one; others stay")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        runs, checked = (
            [weighed(one, Path(folder), options.set) for one in given] for given in (options.recordings, options.check)
        )
    print("in use")
    report([*runs, *checked], FITTED)
    by = fit(runs, FITTED, options.only)
    print(by)
    report([*runs, *checked], by)


if __name__ == "__main__":
    main()
