"""Records anew what nuScenes's devkit says about the boxes of `nuscenes.json`, for `test_nuscenes.py`.

They were drawn at random: usual ones, equal scores, crowds, all ten classes, few found, none found, all false. A row is
the frame, class, x, y, z, length, width, height and yaw, and then the lidar points of the truth, or a score.

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
from nuscenes.eval.detection.algo import accumulate, calc_ap
from nuscenes.eval.detection.data_classes import DetectionBox, DetectionMetrics

RECORDED = Path(__file__).with_name("nuscenes.json")

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
    by_class = {
        name: {
            **{f"ap_{f'{limit:g}'.replace('.', 'p')}": metrics.get_label_ap(name, limit) for limit in config.dist_ths},
            "map": metrics.mean_dist_aps[name],
        }
        for name in config.class_names
    }
    by_class["all"] = {"map": metrics.mean_ap}
    return {
        name: {key: None if np.isnan(value) else float(value) for key, value in figures.items()}
        for name, figures in by_class.items()
    }


def main() -> None:
    cases = json.loads(RECORDED.read_text())["cases"]
    recorded = {
        "versions": {name: version(name) for name in ("nuscenes-devkit", "numpy")},
        "cases": {name: {**case, "figures": answers(case)} for name, case in cases.items()},
    }
    text = json.dumps(recorded, allow_nan=False)
    RECORDED.write_text(text.replace("]], ", "]],\n") + "\n")


if __name__ == "__main__":
    main()
