"""Real KITTI frames through the installed command; skipped where they are absent."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import Lidcam
from helpers import shared
from results import fused_objects


def make_recording(sequence: str, out: Path) -> Path:
    script = shared("tools/real_bags.py")
    shared(f"data/{sequence}")
    subprocess.run([sys.executable, str(script), sequence, str(out)], check=True, capture_output=True)
    return out


def rear_of_the_car_ahead_m(index: int) -> float:
    """The cloud's own: near the first percentile of x over the points of the car in our lane."""
    path = shared(f"data/kitti_raw_sequence/velodyne_points/{index:010}.bin")
    x, y, z, _ = np.fromfile(path, np.float32).reshape(-1, 4).T
    on_car = (x > 4) & (x < 15) & (np.abs(y) < 1) & (z > -1.45) & (z < -0.6)
    return float(np.percentile(x[on_car], 1))


def test_the_car_ahead_is_a_car_and_its_rear_is_where_its_points_are(lidcam: Lidcam, tmp_path: Path) -> None:
    recording, network = make_recording("kitti_raw_sequence", tmp_path / "K.bag"), shared("weights/yolox_nano.onnx")
    run = lidcam("process", recording, tmp_path / "k.mcap", "--model-2d", network, "--duration", 0.6)
    assert run.code == 0, run.err
    frames = list(fused_objects(tmp_path / "k.mcap").values())
    assert len(frames) == 6
    assert rear_of_the_car_ahead_m(0) == pytest.approx(7.98, abs=0.01)
    good = 0
    for index, objects in enumerate(frames):
        rear_m = rear_of_the_car_ahead_m(index)
        ahead = [o for o in objects if o.label == "car" and abs(o.y) < 1.5 and abs(o.x - o.length / 2 - rear_m) < 0.5]
        good += bool(ahead)
    assert good >= 5


def test_parked_cars(lidcam: Lidcam, tmp_path: Path) -> None:
    recording = make_recording("kitti_object_8", tmp_path / "k.bag")
    run = lidcam("process", recording, tmp_path / "k.mcap", "--model-2d", shared("weights/yolox_nano.onnx"))
    assert run.code == 0, run.err
    (objects,) = fused_objects(tmp_path / "k.mcap").values()
    scene = json.loads(shared("data/kitti_object_8/info_from_pkl.json").read_text())["data_list"][0]
    T_velodyne_camera = np.linalg.inv(np.array(scene["images"]["CAM2"]["lidar2cam"]))
    labelled = [i["bbox_3d"][:3] for i in scene["instances"] if i["bbox_label_3d"] >= 0]
    assert len(labelled) == 6
    found = 0
    for bottom_center in labelled:
        x, y, _, _ = T_velodyne_camera @ np.array([*bottom_center, 1.0])
        found += any(np.hypot(o.x - x, o.y - y) < 1.0 for o in objects if o.label == "car")
    assert found >= 4
