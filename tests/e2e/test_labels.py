"""Label files and the predecessor's evaluation folder through the installed command."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from command import Lidcam
from helpers import shared

FRAMES = 3
CAR_M = (1.0, 0.5, 0.11)
"""Centre of the car in the folder."""


def grid(*axes: Any) -> Any:
    """(N, 3) all points of three axes."""
    return np.stack(np.meshgrid(*axes), -1).reshape(-1, 3)


def recall_counts(lidcam: Lidcam, result: Path, truth: Path, *options: object) -> dict[str, Any]:
    figures = result.with_suffix(".json")
    run = lidcam("evaluate", result, "--truth", truth, "--json-file", figures, *options)
    assert run.code == 0, run.err
    tree: dict[str, Any] = json.loads(figures.read_text(encoding="utf-8"))
    return tree


def test_kitti_frames_through_their_label_files(lidcam: Lidcam, tmp_path: Path) -> None:
    """Frame 3 has a car at 13 m and two regions that nobody labelled."""
    labels = shared("data/kitti_object/training/label_2/000003.txt")
    recording, result = tmp_path / "k.bag", tmp_path / "k.mcap"
    script = [sys.executable, str(shared("tools/real_bags.py")), "kitti_object", str(recording)]
    subprocess.run([*script, "--first", "3", "--frames", "1"], check=True, capture_output=True)
    assert lidcam("process", recording, result, "--config", "road").code == 0
    tree = recall_counts(lidcam, result, labels, "--set", "evaluate.region=[[0,0],[70,59],[70,-59]]")
    car = tree["sources"]["lidar"]["car"]
    assert car["truth"] == 1
    assert car["recall"] == 1


def test_the_evaluation_folder_is_recording_and_truth(lidcam: Lidcam, tmp_path: Path) -> None:
    folder, result = tmp_path / "test_dataset", tmp_path / "out.mcap"
    (folder / "pcd").mkdir(parents=True)
    (folder / "odom").mkdir()
    rng = np.random.default_rng(1)
    ground = np.c_[rng.uniform(-2, 2, (4000, 2)), rng.normal(0, 0.002, 4000)]
    rows = []
    across, along, up = np.linspace(-0.11, 0.11, 12), np.linspace(-0.165, 0.165, 16), np.linspace(0.03, 0.2, 9)
    ends, sides = grid((-0.165, 0.165), across, up), grid(along, (-0.11, 0.11), up)
    for number in range(FRAMES):
        x = CAR_M[0] - 0.05 * number
        cloud = np.r_[ground, np.r_[ends, sides] + np.array([x, CAR_M[1], 0.0])]
        np.savetxt(folder / "pcd" / f"{number}.txt", np.c_[cloud, np.full(len(cloud), 0.5)], "%.4f")
        rows.append(f"{x} {CAR_M[1]} {CAR_M[2]} 0")
    (folder / "odom" / "30000.txt").write_text("\n".join(rows))
    run = lidcam("process", folder, result, "--config", "sandbox")
    assert run.code == 0, run.err
    tree = recall_counts(lidcam, result, folder)
    car = tree["sources"]["fused"]["car"]
    assert car["truth"] == FRAMES
    assert car["recall"] == 1
