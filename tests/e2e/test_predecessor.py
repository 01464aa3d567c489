"""The script that converts data sets of the predecessor system, and what the command makes of its recordings."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from command import Lidcam
from helpers import ROOT
from results import messages_of, topics_of

SCRIPT = ROOT / "examples" / "convert_predecessor.py"
SCRIPT_NAMES = runpy.run_path(str(SCRIPT))
FRAMES = 3
CAR_M = (1.0, 0.5, 0.11)
"""Centre of the car in the first frame."""

# Camera 11 as published, at (-0.143, 0.371, 0.393) looking along +y: its optical frame, and its body frame (x forward).
C2P: Any = [[504.78216005824515, 0, 320.5, 0], [0, 504.78216005824515, 240.5, 0], [0, 0, 1, 0]]
W2C: Any = [[1, 0, 0, 0.143], [0, 0, -1, 0.393], [0, 1, 0, -0.371], [0, 0, 0, 1]]
W2C_BODY: Any = [[0, 1, 0, -0.371], [-1, 0, 0, -0.143], [0, 0, 1, -0.393], [0, 0, 0, 1]]
W2C_12: Any = [[1, 0, 0, 0.1], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]
"""Singular, as published."""


def grid(*axes: Any) -> Any:
    """(N, 3) all points of three axes."""
    return np.stack(np.meshgrid(*axes), -1).reshape(-1, 3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of a car on a table, with images of two cameras."""
    folder = tmp_path_factory.mktemp("predecessor") / "test_dataset"
    (folder / "pcd").mkdir(parents=True)
    (folder / "odom").mkdir()
    rng = np.random.default_rng(1)
    ground = np.c_[rng.uniform(-2, 2, (4000, 2)), rng.normal(0, 0.002, 4000)]
    across, along, up = np.linspace(-0.11, 0.11, 12), np.linspace(-0.165, 0.165, 16), np.linspace(0.03, 0.2, 9)
    shell = np.r_[grid((-0.165, 0.165), across, up), grid(along, (-0.11, 0.11), up)]
    rows = []
    for number in range(FRAMES):
        x = CAR_M[0] - 0.05 * number
        cloud = np.r_[ground, shell + np.array([x, CAR_M[1], 0.0])]
        np.savetxt(folder / "pcd" / f"{number}.txt", np.c_[cloud, np.full(len(cloud), 0.5)], "%.4f")
        rows.append(f"{x} {CAR_M[1]} {CAR_M[2]} 0")
        (folder / "img" / str(number)).mkdir(parents=True)
        for camera in range(2):
            image = np.full((480, 640, 3), 200, np.uint8)
            cv2.imwrite(str(folder / "img" / str(number) / f"{camera}.jpg"), image)
    (folder / "odom" / "30000.txt").write_text("\n".join(rows))
    cameras = {"camera_11": {"w2c": W2C, "c2p": C2P}, "camera_12": {"w2c": W2C_12, "c2p": C2P}}
    (folder / "geometry.yaml").write_text(yaml.safe_dump({"cameras": cameras}))
    np.savetxt(folder / "calib.txt", [[11, *np.ravel(W2C_BODY), *np.ravel(C2P)]])
    return folder


def test_a_data_set_is_processed_and_evaluated(lidcam: Lidcam, folder: Path, tmp_path: Path) -> None:
    recording, result, figures = tmp_path / "drive.mcap", tmp_path / "out.mcap", tmp_path / "figures.json"
    command = [sys.executable, SCRIPT, folder, recording, "--calibration", folder / "geometry.yaml"]
    done = subprocess.run([*map(str, command)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("left out: camera 12 is singular")
    run = lidcam("process", recording, result, "--config", "sandbox")
    assert run.code == 3, run.err  # camera 12
    run = lidcam("evaluate", result, "--json-file", figures)
    assert run.code == 0, run.err
    tree = json.loads(figures.read_text(encoding="utf-8"))
    assert (tree["frames_with_truth"], tree["sources"]["fused"]["car"]["truth"]) == (FRAMES, FRAMES)
    assert tree["sources"]["fused"]["car"]["recall"] == 1
    assert topics_of(result)["/cam11/image/compressed"][1] == FRAMES


def test_both_calibrations_say_the_same(folder: Path, tmp_path: Path) -> None:
    found = []
    for name in ("geometry.yaml", "calib.txt"):
        SCRIPT_NAMES["convert"](folder, tmp_path / f"{name}.mcap", folder / name)
        [(_, info)] = messages_of(tmp_path / f"{name}.mcap", "/camera_info_11")
        [(_, tf)] = messages_of(tmp_path / f"{name}.mcap", "/tf_static")
        place, turn = tf.transforms[0].transform.translation, tf.transforms[0].transform.rotation
        assert (info.width, info.height) == (640, 480)
        found.append([*info.k, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])
    expected = [*np.array(C2P)[:, :3].reshape(9), -0.143, 0.371, 0.393, -np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    np.testing.assert_allclose(found, [expected, expected], atol=1e-9)


@pytest.mark.parametrize(
    ("row", "position", "yaw", "size_m"),
    [
        ("1 2 0.5", [1, 2, 0.112], 0.5, [0.33, 0.22, 0.21]),
        ("1, 2, 0.3, 0.5", [1, 2, 0.3], 0.5, [0.33, 0.22, 0.21]),
        ("1 2 0.3 0 0 0.6 0.8", [1, 2, 0.3], 2 * np.arctan2(0.6, 0.8), [0.33, 0.22, 0.21]),
        ("1 2 0.3 0 0 0.6 0.8 1 2 3 4 5 6", [1, 2, 0.3], 2 * np.arctan2(0.6, 0.8), [0.33, 0.22, 0.21]),
        ("1 2 0.3 4 2 1.5 0.5", [1, 2, 0.3], 0.5, [4, 2, 1.5]),
    ],
)
def test_rows_of_odometry(tmp_path: Path, row: str, position: Any, yaw: float, size_m: Any) -> None:
    (tmp_path / "30000.txt").write_text(row)
    [(found, turn, size)] = SCRIPT_NAMES["true_cars"](tmp_path / "30000.txt")
    np.testing.assert_allclose(found, position)
    np.testing.assert_allclose(2 * np.arctan2(turn[2], turn[3]), yaw)
    np.testing.assert_allclose(size, size_m)


@pytest.mark.parametrize(
    ("files", "problem"),
    [
        ({}, "expected clouds pcd/0.txt, pcd/1.txt, ... and odometry odom/30000.txt"),
        ({"pcd/0.txt": "", "odom/30000.txt": "1 2"}, "expected rows of 3, 4, 7 or 13 finite numbers, found 2"),
    ],
)
def test_what_is_no_data_set_is_told(tmp_path: Path, files: dict[str, str], problem: str) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    with pytest.raises(SystemExit, match=re.escape(problem)):
        SCRIPT_NAMES["convert"](tmp_path, tmp_path / "out.mcap", None)
    assert not (tmp_path / "out.mcap").exists()


def test_a_missing_calibration_is_told_in_one_line(folder: Path, tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), str(folder), str(tmp_path / "out.mcap"), "--calibration", "none.yaml"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (1, "none.yaml: No such file or directory\n")
    assert not (tmp_path / "out.mcap").exists()
