"""What detectors find in drawn worlds that nothing was trained on, by the lidars alone.

    python benchmarks/measured/held_out_worlds.py --family road [--worlds 200] NAME:SETTING,... [NAME:SETTING,... ...]

Prints a table with a row for each class and NAME, whose settings choose the detector, as in
`clusters:detect3d.method=cluster,detect3d.score=learned`: average precision from above at an IoU of 0.5 and by
distances, calibration error of boxes from 0.05 on, and of those from 0.5 on found and false ones and the errors of what
was found. An object counts if 10 points and more are on it and it is within 60 m along the ground.
"""

import argparse
import re
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import chain
from multiprocessing import get_context
from typing import Any

import numpy as np
from pages import table

from lidcam.bags.simulator.worlds.draw import Family
from lidcam.bags.simulator.worlds.training_scenes import SWEEPS_PER_WORLD, TrainingSweep, sweep
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.evaluation.detection.detection_evaluation import DetectionEvaluation
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, SourceBoxes, TruthBoxes3D
from lidcam.pipeline.stages.combine import Combine
from lidcam.pipeline.stages.detect3d import Detect3D
from lidcam.run.build import decided
from lidcam.training.examples import SWEEPS_OF_A_WORLD, cloud_of, rig_of

FIRST_WORLD = 2_000_000  # trainings take worlds from their seed on, and judge themselves in those from a million on

EVALUATED = ("evaluate.max_range_m=60", "evaluate.min_lidar_points=10", "evaluate.iou=[0.5]")
MIN_SCORES = {"all": 0.0, "calibrated": 0.05, "reported": 0.5}

Found = tuple[TruthBoxes3D, dict[str, Boxes3D]]


def main() -> None:
    """Look at all worlds, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--family", choices=("road", "crossing", "sandbox"), required=True)
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("detectors", nargs="+", metavar="NAME:SETTING,...")
    given = parser.parse_args()
    detectors = dict(map(named_settings, given.detectors))
    evaluation = DetectionEvaluation(load_config(given.family, EVALUATED), ())
    look = partial(look_at_world, given.family, detectors)
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        worlds = pool.map(look, range(FIRST_WORLD, FIRST_WORLD + given.worlds))
        for row, (truth, found) in enumerate(chain.from_iterable(worlds)):
            sources = {}
            for name, boxes in found.items():
                for kind, min_score in MIN_SCORES.items():
                    kept = boxes.select(boxes.scores >= min_score)
                    sources[f"{name} {kind}"] = SourceBoxes(kept, np.full(len(kept), UNKNOWN, np.int64))
            evaluation.add_frame(EvaluationFrame(row, 0, truth, sources))
    _print_table(evaluation.figures()["sources"], list(detectors))


def named_settings(given: str) -> tuple[str, tuple[str, ...]]:
    """NAME and its settings; a comma parts them where a key follows, so that values may be lists."""
    name, _, rest = given.partition(":")
    return name, tuple(re.split(r",(?=[^,=\[\]{}]+=)", rest)) if rest else ()


def look_at_world(family: Family, detectors: dict[str, tuple[str, ...]], world: int) -> list[Found]:
    """Truth and boxes by detector of some sweeps of a world."""
    configs = {name: load_config(family, settings) for name, settings in detectors.items()}
    first, step = world * SWEEPS_PER_WORLD, SWEEPS_PER_WORLD // SWEEPS_OF_A_WORLD
    answer = []
    for seed in range(first, first + SWEEPS_PER_WORLD, step):
        taken = sweep(family, seed)
        found = {}
        for name, config in configs.items():
            rig, combined = combined_cloud(taken, config)
            found[name] = Detect3D(rig, decided(config, rig))(combined)
        answer.append((_truth(taken, load_config(family), rig_of([taken.origin]).site_frame), found))
    return answer


def combined_cloud(taken: TrainingSweep, config: Config) -> tuple[Rig, CombinedCloud]:
    """The lidar of a sweep, and its cloud as a run combines it."""
    rig = rig_of([taken.origin])
    return rig, Combine(rig, config.combine)(SensorBundle(0, 0, 0, {}), {"0": cloud_of(taken, "0")})


def _truth(taken: TrainingSweep, config: Config, site_frame: str) -> TruthBoxes3D:
    ids = np.array([config.class_id_of_label.get(name, UNKNOWN) for name in taken.class_names], np.int32)
    count = len(ids)
    unknown = np.full(count, UNKNOWN)
    return TruthBoxes3D(
        0, site_frame, taken.centers, taken.sizes, taken.yaws, ids, np.array(taken.class_names, np.str_),
        unknown.astype(np.int64), taken.point_counts, unknown.astype(np.int32), np.zeros(count, np.bool_),
    )  # fmt: skip


def _print_table(sources: Any, names: list[str]) -> None:
    head = ["", "", "objects", "AP IoU 0.5", "AP distance", "ECE", "found", "false", "position", "heading", "flips"]
    rows = []
    for label in sources[f"{names[0]} all"]:
        for name in names:
            every, calibrated, reported = (sources[f"{name} {kind}"][label] for kind in MIN_SCORES)
            if not every["truth"] or label == "all":
                continue
            errors = reported["errors"]
            rows.append([
                label, name, f"{every['truth']}", f"{every['ap_bev_r40_50']:.3f}", f"{every['distance']['map']:.3f}",
                _text(calibrated["calibration"]["ece"], "{:.3f}"), f"{reported['right']}", f"{reported['false']}",
                _text(errors["position_bev_m"]["p50"], "{:.3f} m"),
                _text(errors["heading_mod_180_deg"]["p50"], "{:.1f} deg"), _text(errors["flips"], "{:.1%}"),
            ])  # fmt: skip
    print("\n".join(table(head, rows)))


def _text(value: float | None, form: str) -> str:
    return "--" if value is None else form.format(value)


if __name__ == "__main__":
    main()
