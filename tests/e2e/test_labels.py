"""Label files through the installed command."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from command import Lidcam
from helpers import shared


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
