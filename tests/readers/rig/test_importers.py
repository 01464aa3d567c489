"""KITTI's calibration files, judged by other numbers than ours."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers import shared
from memory_recording import MemoryRecording
from rig_messages import cloud, image_message

from lidcam.pipeline.core.errors import CalibrationError, ConfigError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.discovery import Discovery, discover_rig
from lidcam.readers.rig.rig_file import load_rig


def pixels_of(found: Discovery, name: str, points: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    camera = next(camera for camera in found.rig.cameras if camera.name == name)
    return camera.model.project(camera.T_camera_site.apply(points))[0] - 0.5


def images(*topics: str, size: tuple[int, int] = (640, 480)) -> list[RawMessage]:
    return [image_message(topic, size=size) for topic in topics]


def found_in(path: Path, messages: list[RawMessage], site: str = "") -> Discovery:
    return discover_rig(MemoryRecording(messages), Config.model_validate({"rig": {"site_frame": site}}), load_rig(path))


def flat(matrix: Any) -> list[float]:
    return np.array(matrix, float).reshape(-1).tolist()


P2, R0 = "P2: 1 0 0 0 0 1 0 0 0 0 1 0\n", "R0_rect: 1 0 0 0 1 0 0 0 1\n"
TR = P2.replace("P2", "Tr_velo_to_cam")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (f"P2: 1 2 3\n{R0}{TR}", "P2: expected 3 x 4 numbers, found 3"),
        (P2 + R0, "Tr_velo_to_cam or Tr_velo_cam or Tr, found P2, R0_rect"),
        (R0 + TR, "projections"),
    ],
)
def test_mistakes_are_told_in_one_line(tmp_path: Path, content: Any, reason: str) -> None:
    (tmp_path / "calib").write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    with pytest.raises((CalibrationError, ConfigError), match=reason):
        load_rig(tmp_path / "calib")


def test_a_singular_projection_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "calib").write_text(f"P2: 0 0 0 0 0 0 0 0 0 0 0 0\n{R0}{TR}")
    found = found_in(tmp_path / "calib", [cloud("/points", "site"), *images("/image_raw_11")], "site")
    assert "singular" in found.faults[0].reason


VELODYNE = cloud("/velodyne_points", "velodyne")
KITTI_PX = (1242, 375)


def kitti_object_8(tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """The calibration file of KITTI object frame 8, from the numbers of mmdetection3d's index, and that index."""
    scene = json.loads(shared("data/kitti_object_8/info_from_pkl.json").read_text())["data_list"][0]
    lines = {f"P{n}": np.array(scene["images"][f"CAM{n}"]["cam2img"])[:3] for n in range(4)}
    lines["R0_rect"] = np.array(scene["images"]["R0_rect"])[:3, :3]
    lines["Tr_velo_to_cam"] = np.array(scene["lidar_points"]["Tr_velo_to_cam"])[:3]
    path = tmp_path / "000008.txt"
    path.write_text("".join(f"{name}: {' '.join(map(repr, flat(m)))}\n" for name, m in lines.items()))
    return path, scene


def test_kitti_object(tmp_path: Path) -> None:
    path, scene = kitti_object_8(tmp_path)
    points = np.fromfile(shared("data/kitti_object_8/000008.bin"), np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
    one = found_in(path, [VELODYNE, *images("/camera/image_raw", size=KITTI_PX)])
    assert [(c.name, c.topic) for c in one.rig.cameras] == [("cam2", "/camera/image_raw")]
    assert "cam2: has no topic in the rig file; by order it is /camera/image_raw" in one.notes
    found = found_in(path, [VELODYNE, *images(*(f"/kitti/image_{n}" for n in range(4)), size=KITTI_PX)])
    assert {c.name: c.topic for c in found.rig.cameras} == {f"cam{n}": f"/kitti/image_{n}" for n in range(4)}
    for number in range(4):
        judge = np.c_[points, np.ones(len(points))] @ np.array(scene["images"][f"CAM{number}"]["lidar2img"]).T
        np.testing.assert_allclose(pixels_of(found, f"cam{number}", points), judge[:, :2] / judge[:, 2:3], atol=0.01)


@pytest.mark.parametrize("file", ["kitti_raw_sequence/calib_2011_09_26.txt", "kitti_object/training/calib/000001.txt"])
def test_kitti_files_as_they_are(file: str) -> None:
    path = shared(f"data/{file}")
    found = found_in(path, [VELODYNE, *images("/camera/image_raw", size=KITTI_PX)])
    rows = {
        line.split(":")[0]: np.array(line.split()[1:], float)
        for line in path.read_text().splitlines()
        if line[:1] in "PRT" and line
    }
    rect, velo = np.eye(4), np.eye(4)
    rect[:3, :3] = rows["R0_rect"].reshape(3, 3)
    velo[:3] = rows["Tr_velo_to_cam"].reshape(3, 4)
    points = np.array([[10.0, 2, -1], [30, -5, 0], [6, 0.5, -1.5]])
    judge = np.c_[points, np.ones(3)] @ (rows["P2"].reshape(3, 4) @ rect @ velo).T
    np.testing.assert_allclose(pixels_of(found, "cam2", points), judge[:, :2] / judge[:, 2:], atol=0.01)


def test_kitti_raw_needs_both_files_and_takes_either(tmp_path: Path) -> None:
    path, _ = kitti_object_8(tmp_path)
    rows = {line.split(":")[0]: line.split(": ")[1] for line in path.read_text().splitlines()}
    velo = np.array(rows["Tr_velo_to_cam"].split(), float).reshape(3, 4)
    cam_to_cam = tmp_path / "calib_cam_to_cam.txt"
    cam_to_cam.write_text(
        "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.95e-02\nS_rect_02: 1242 375\n"
        f"R_rect_00: {rows['R0_rect']}\nP_rect_02: {rows['P2']}\n"
    )
    velo_to_cam = tmp_path / "calib_velo_to_cam.txt"
    with pytest.raises(CalibrationError, match="calib_velo_to_cam"):
        load_rig(cam_to_cam)
    R, T = (" ".join(map(repr, flat(part))) for part in (velo[:, :3], velo[:, 3]))
    velo_to_cam.write_text(f"calib_time: 15-Mar-2012 11:37:16\nR: {R}\nT: {T}\n")
    both = load_rig(cam_to_cam)
    assert both == load_rig(velo_to_cam)
    assert both.cameras is not None
    expected = load_rig(path)
    assert expected.cameras is not None
    np.testing.assert_allclose(both.cameras["cam2"].T_camera_site, expected.cameras["cam2"].T_camera_site)  # type: ignore[arg-type]  # given
    assert (both.cameras["cam2"].width_px, both.cameras["cam2"].height_px) == (1242, 375)
