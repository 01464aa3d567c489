"""Records what nuScenes's devkit says about random detections, for `test_nuscenes.py`.

Needs an environment of its own, since the devkit wants other versions of NumPy and OpenCV than lidcam:

    python -m venv judge && judge/bin/pip install nuscenes-devkit==1.2.0
    judge/bin/python tests/pipeline/evaluation/detection/recorded/record_nuscenes.py
"""

import json
from collections import defaultdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from nuscenes.eval.common.config import config_factory
from nuscenes.eval.common.data_classes import EvalBoxes
from nuscenes.eval.common.loaders import add_center_dist, filter_eval_boxes
from nuscenes.eval.detection.algo import accumulate, calc_ap, calc_tp
from nuscenes.eval.detection.constants import DETECTION_NAMES, TP_METRICS
from nuscenes.eval.detection.data_classes import DetectionBox, DetectionMetrics

SIZES_M = {"car": (4.6, 1.9, 1.7), "truck": (6.9, 2.5, 2.8), "bus": (11.0, 2.9, 3.5), "pedestrian": (0.7, 0.7, 1.8)}
CASES = {
    # name: frames, true objects a frame, classes, share found, false ones a frame, steps of the score, spread in metres
    "usual": (12, 5, ("car", "pedestrian", "truck", "bus"), 0.85, 2.0, 1024, 30.0),
    "equal_scores": (12, 6, ("car", "pedestrian"), 0.8, 3.0, 8, 25.0),
    "crowded": (4, 25, ("car", "pedestrian", "bicycle"), 0.9, 6.0, 256, 6.0),
    "ten_classes": (12, 10, tuple(DETECTION_NAMES), 0.8, 4.0, 1024, 35.0),
    "little_recall": (15, 4, ("car", "bus"), 0.08, 1.0, 1024, 30.0),
    "nothing_found": (3, 2, ("car",), 0.0, 0.0, 1024, 30.0),
    "all_false": (3, 0, ("car",), 0.0, 4.0, 1024, 30.0),
}


Row = list[Any]
Case = dict[str, Any]


class Drive:
    """Stands in for the data set: the vehicle is at the origin, and there are no bicycle racks."""

    def get(self, table: str, token: str) -> Any:
        records: dict[str, Any] = {
            "sample": {"data": {"LIDAR_TOP": token}, "anns": []},
            "sample_data": {"ego_pose_token": token},
            "ego_pose": {"translation": (0.0, 0.0, 0.0)},
        }
        return records[table]


def make_case(
    seed: int,
    frames: int,
    objects: int,
    classes: tuple[str, ...],
    found_share: float,
    false_rate: float,
    score_steps: int,
    spread_m: float,
) -> Case:
    """Rows of frame, class, x, y, z, length, width, height, yaw; then the lidar points of truth, or a score."""
    rng = np.random.default_rng(seed)

    def score(a: float, b: float) -> float:
        return float(np.round(rng.beta(a, b) * score_steps) / score_steps)

    def box(frame: int, name: str, center: Any, size: Any, yaw: float) -> Row:
        wrapped = (yaw + np.pi) % (2 * np.pi) - np.pi
        return [frame, name, *(round(float(value), 3) for value in (*center, *size, wrapped))]

    truth: list[Row] = []
    found: list[Row] = []
    for frame in range(frames):
        for _ in range(objects):
            name = str(rng.choice(classes))
            center, yaw = rng.normal(0, (spread_m, spread_m, 1)), rng.uniform(-np.pi, np.pi)
            size = np.array(SIZES_M.get(name, (2.0, 1.0, 1.5))) * rng.uniform(0.8, 1.2, 3)
            truth.append([*box(frame, name, center, size, yaw), int(rng.integers(0, 8))])
            if rng.random() < found_share:
                name = name if rng.random() < 0.93 else str(rng.choice(classes))
                off = rng.normal(0, rng.choice([0.2, 0.8, 2.0]), 3)
                turn = rng.normal(0, 0.2) + np.pi * (rng.random() < 0.15)
                size = size * rng.uniform(0.8, 1.25, 3)
                found.append([*box(frame, name, center + off, size, yaw + turn), score(4, 2)])
        for _ in range(rng.poisson(false_rate)):
            name = str(rng.choice(classes))
            size = np.array(SIZES_M.get(name, (2.0, 1.0, 1.5)))
            center = rng.normal(0, (spread_m, spread_m, 1))
            found.append([*box(frame, name, center, size, rng.uniform(-np.pi, np.pi)), score(2, 4)])
    return {"frames": frames, "truth": truth, "found": found}


def devkit_boxes(frames: int, rows: list[Row], kind: str) -> Any:
    boxes = EvalBoxes()
    by_frame = defaultdict(list)
    for frame, name, x, y, z, length, width, height, yaw, last in rows:
        by_frame[frame].append(
            DetectionBox(
                sample_token=str(frame),
                translation=(x, y, z),
                size=(width, length, height),
                rotation=(float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))),
                velocity=(0.0, 0.0) if kind == "truth" else (np.nan, np.nan),
                num_pts=last if kind == "truth" else -1,
                detection_name=name,
                detection_score=-1.0 if kind == "truth" else last,
                attribute_name="vehicle.moving" if kind == "truth" else "",
            )
        )
    for frame in range(frames):
        boxes.add_boxes(str(frame), by_frame[frame])
    return boxes


def answers(case: Case) -> Any:
    config, drive = config_factory("detection_cvpr_2019"), Drive()
    sides = []
    for kind in ("truth", "found"):
        boxes = add_center_dist(drive, devkit_boxes(case["frames"], case[kind], kind))
        sides.append(filter_eval_boxes(drive, boxes, config.class_range) if boxes.all else boxes)
    metrics = DetectionMetrics(config)
    for name in config.class_names:
        data = {limit: accumulate(*sides, name, config.dist_fcn_callable, limit) for limit in config.dist_ths}
        for limit in config.dist_ths:
            metrics.add_label_ap(name, limit, calc_ap(data[limit], config.min_recall, config.min_precision))
        for metric in TP_METRICS:
            absent = {"traffic_cone": ("attr_err", "vel_err", "orient_err"), "barrier": ("attr_err", "vel_err")}
            value = calc_tp(data[config.dist_th_tp], config.min_recall, metric)
            metrics.add_label_tp(name, metric, np.nan if metric in absent.get(name, ()) else value)
    names = {"ate": "trans_err", "ase": "scale_err", "aoe": "orient_err"}
    by_class = {
        name: {
            **{f"ap_{f'{limit:g}'.replace('.', 'p')}": metrics.get_label_ap(name, limit) for limit in config.dist_ths},
            "map": metrics.mean_dist_aps[name],
            **{short: metrics.get_label_tp(name, metric) for short, metric in names.items()},
        }
        for name in config.class_names
    }
    overall = {short: metrics.tp_errors[metric] for short, metric in names.items()}
    by_class["all"] = {"map": metrics.mean_ap, **overall, "nds": metrics.nd_score}
    return {
        name: {key: None if np.isnan(value) else float(value) for key, value in figures.items()}
        for name, figures in by_class.items()
    }


def main() -> None:
    cases = {name: make_case(seed, *arguments) for seed, (name, arguments) in enumerate(CASES.items())}
    recorded = {
        "versions": {name: version(name) for name in ("nuscenes-devkit", "numpy")},
        "cases": {name: {**case, "figures": answers(case)} for name, case in cases.items()},
    }
    text = json.dumps(recorded, allow_nan=False)
    Path(__file__).with_name("nuscenes.json").write_text(text.replace("]], ", "]],\n") + "\n")


if __name__ == "__main__":
    main()
