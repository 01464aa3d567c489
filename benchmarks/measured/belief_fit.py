"""Fit the coefficients of the belief anew, from recordings whose truth is known.

    python benchmarks/measured/belief_fit.py RECORDING[,MODEL.onnx[,TRUTH]] ... [--keep FOLDER]

Each recording is processed with every threshold on scores open. A hypothesis is right if it lies within 2 m, scaled, of
a true object of its class that no better one shows (docs/figures.md). Twice: as the cameras and the lidars weighed it,
and the lidars' boxes by themselves, which is what frames without images have. The coefficients minimise the
cross-entropy, each recording counting the same, with a weak pull towards those in use; what is learned during a run is
learned anew with each try. Printed are the coefficients, the cross-entropy, the expected calibration error by class,
and what thresholds from 0.2 to 0.6 would find of what is there, and what false objects.
"""

import argparse
import pickle
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from lidcam.evaluation.frames import EvaluationFrames
from lidcam.job import make_job
from lidcam.run import RunObserver, process_recording
from pipeline.core.arrays import F64, Bools
from pipeline.core.detections import Boxes3D, Hypotheses
from pipeline.core.frame import FrameResult
from pipeline.core.settings.config import Config
from pipeline.evaluation.detection.criteria import Criteria
from pipeline.evaluation.detection.gathering import Gathering
from pipeline.evaluation.detection.tables import IGNORED
from pipeline.evaluation.records import UNKNOWN, EvaluationFrame, SourceBoxes, TruthBoxes3D
from pipeline.fusion.belief import FITTED, Coefficients, camera_evidence, joined, log_odds_before_cameras, probability
from pipeline.fusion.looks import Looks, looks_at
from pipeline.fusion.recall import RecallCounts
from readers.results.result import open_result
from readers.truth.open import open_truth

OPEN = {"fuse.min_score": 0.0, "output.images": False, "output.clouds": False}

PULL = 1e-4
"""Weight of the squared distance from the coefficients in use."""

ROUNDS = 3
"""Labels and what is learned during a run depend on the coefficients, and are made so many times."""


@dataclass(frozen=True, eq=False)
class WeighedFrame:
    """What was weighed in one frame: with the cameras, and the lidars' boxes alone."""

    boxes: Boxes3D
    lidar_count: int
    looks: Looks
    alone: Boxes3D
    truth: TruthBoxes3D


@dataclass(frozen=True, eq=False)
class Weighed:
    """A recording with its truth."""

    name: str
    config: Config
    cameras: tuple[str, ...]
    frames: list[WeighedFrame]


class Collector(RunObserver):
    """Keeps what is weighed in each frame."""

    def __init__(self) -> None:
        self.frames: list[tuple[Hypotheses, Looks, Boxes3D]] = []

    def frame(self, result: FrameResult) -> None:
        """Look at one frame."""
        found = looks_at(result.hypotheses, result.detections.cameras, result.views, result.combined)
        self.frames.append((result.hypotheses, found, result.detections.lidar))


def weighed(recording: str, result: Path) -> Weighed:
    """Process a recording, and find its truth."""
    path, model, truth = (*recording.split(","), "", "")[:3]
    collector = Collector()
    job = make_job(path, result, settings=OPEN, model_2d=model or None, workers=1, overwrite=True)
    process_recording(job, collector)
    frames = []
    with open_result(result) as opened, open_truth(opened, [Path(truth)] if truth else []) as found:
        for evaluated, (hypotheses, looks, alone) in zip(
            EvaluationFrames(opened, found), collector.frames, strict=True
        ):
            if evaluated.truth is not None:
                frames.append(WeighedFrame(hypotheses.boxes, hypotheses.lidar_count, looks, alone, evaluated.truth))
        return Weighed(path, opened.config, tuple(camera.name for camera in opened.rig.cameras), frames)


def log_odds(run: Weighed, by: Coefficients) -> tuple[list[F64], list[F64]]:
    """Log odds of the hypotheses and of the lidars' boxes by themselves, frame by frame."""
    sizes = np.array([prior.size_m for prior in run.config.classes])
    recall = RecallCounts(run.cameras)
    together, alone = [], []
    for frame in run.frames:
        before = _before(frame.boxes, frame.lidar_count, sizes, by)
        evidence = camera_evidence(frame.looks, recall.plain(frame.looks), by)
        recall.learn(frame.looks, before, evidence, by)
        together.append(before + joined(evidence, by))
        alone.append(_before(frame.alone, len(frame.alone), sizes, by))
    return together, alone


def _before(boxes: Boxes3D, lidar_count: int, sizes: F64, by: Coefficients) -> F64:
    shapes = (sizes[:, 0] / sizes[:, 2])[boxes.class_ids]
    is_lidar = np.arange(len(boxes)) < lidar_count
    return log_odds_before_cameras(boxes.scores.astype(np.float64), shapes, boxes.sources, is_lidar, by)


def labels(run: Weighed, found: tuple[list[F64], list[F64]]) -> tuple[F64, F64]:
    """1 for what is right, 0 for what is false, NaN for what is ignored: of all hypotheses, of all lidar boxes."""
    gathering = Gathering(run.config, ())
    for index, (frame, together, alone) in enumerate(zip(run.frames, *found, strict=True)):
        sources = {"fused": _source(frame.boxes, together), "lidar": _source(frame.alone, alone)}
        gathering.add(EvaluationFrame(index, index, frame.truth, sources))
    row = Criteria.of(run.config).position_row
    tables = gathering.found()
    matches = [tables[name].matches[row] for name in ("fused", "lidar")]
    right, alone_right = (np.where(found == IGNORED, np.nan, (found >= 0).astype(np.float64)) for found in matches)
    return right, alone_right


def _source(boxes: Boxes3D, log_odds: F64) -> SourceBoxes:
    scores = probability(log_odds).astype(np.float32)
    return SourceBoxes(replace(boxes, scores=scores), np.full(len(boxes), UNKNOWN, np.int64))


def cross_entropy(log_odds: F64, right: F64) -> float:
    """Mean over what is not ignored."""
    kept = ~np.isnan(right)
    p = probability(log_odds[kept])
    return float(-(right[kept] * np.log(p) + (1 - right[kept]) * np.log(1 - p)).mean()) if kept.any() else 0.0


def fit(runs: Sequence[Weighed], start: Coefficients) -> Coefficients:
    """The coefficients that describe these runs best."""
    names = [*asdict(start)]
    first = np.array([*asdict(start).values()])
    by = start
    for _ in range(ROUNDS):
        truths = [labels(run, log_odds(run, by)) for run in runs]

        def loss(values: F64, truths: list[tuple[F64, F64]] = truths) -> float:
            tried = Coefficients(**dict(zip(names, values.tolist(), strict=True)))
            total = PULL * float(((values - first) ** 2).sum())
            for run, (right, alone_right) in zip(runs, truths, strict=True):
                together, alone = log_odds(run, tried)
                total += cross_entropy(np.concatenate(together), right)
                total += cross_entropy(np.concatenate(alone), alone_right)
            return total

        limits = [(0.0, 1.0) if name == "further" else (None, None) for name in names]
        found = minimize(loss, np.array([*asdict(by).values()]), method="L-BFGS-B", bounds=limits)
        by = Coefficients(**dict(zip(names, found.x.tolist(), strict=True)))
    return by


def calibration_error(p: F64, right: Bools) -> float:
    """Expected calibration error over ten bins."""
    bins = np.minimum((p * 10).astype(np.intp), 9)
    gaps = np.bincount(bins, p, 10) - np.bincount(bins, right, 10)
    return float(np.abs(gaps).sum() / max(len(p), 1))


def report(runs: Sequence[Weighed], by: Coefficients) -> None:
    """Print what the coefficients come to, by recording and class."""
    for run in runs:
        found = log_odds(run, by)
        truths = labels(run, found)
        for what, odds, right, boxes in (
            ("weighed", found[0], truths[0], [frame.boxes for frame in run.frames]),
            ("lidars alone", found[1], truths[1], [frame.alone for frame in run.frames]),
        ):
            p, ids = probability(np.concatenate(odds)), np.concatenate([one.class_ids for one in boxes])
            kept = ~np.isnan(right)
            line = [f"{Path(run.name).name:16} {what:12} {cross_entropy(np.concatenate(odds), right):.3f}"]
            for class_id, name in enumerate(run.config.class_names):
                rows = kept & (ids == class_id)
                if rows.any():
                    line.append(f"{name} {calibration_error(p[rows], right[rows] > 0):.3f} of {rows.sum()}")
            best = _best(p[kept], right[kept] > 0)
            print("  ".join([*line, best]))


def _best(p: F64, right: Bools) -> str:
    texts = []
    for limit in (0.2, 0.3, 0.4, 0.5, 0.6):
        kept = p >= limit
        texts.append(f"{limit}: {int((right & kept).sum())}/{int(right.sum())} +{int((~right & kept).sum())}")
    return " | ".join(texts)


def main() -> None:
    """Process, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", metavar="RECORDING[,MODEL[,TRUTH]]")
    parser.add_argument("--keep", type=Path, help="folder in which what was weighed is kept from one time to the next")
    parser.add_argument("--check", nargs="*", default=[], help="recordings that are reported and not fitted to")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        runs, checked = (
            [_kept(one, Path(folder), options.keep) for one in given] for given in (options.recordings, options.check)
        )
    print("in use")
    report([*runs, *checked], FITTED)
    by = fit(runs, FITTED)
    print(by)
    report([*runs, *checked], by)


def _kept(recording: str, folder: Path, keep: Path | None) -> Weighed:
    kept = keep / (recording.replace("/", "_") + ".pickle") if keep else None
    if kept is not None and kept.exists():
        found: Weighed = pickle.loads(kept.read_bytes())  # noqa: S301 - our own
        return found
    run = weighed(recording, folder / "result.mcap")
    if kept is not None:
        kept.write_bytes(pickle.dumps(run))
    return run


if __name__ == "__main__":
    main()
