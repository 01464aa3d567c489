"""Calibration files of ROS, KITTI, Kalibr and Autoware, judged by other libraries or numbers than ours."""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from helpers import shared
from memory_recording import MemoryRecording
from rig_messages import cloud, image_message, static
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.discovery import Discovery, discover_rig
from lidcam.readers.rig.rig_file import load_rig, merge_rigs

F64 = np.ndarray[Any, np.dtype[np.float64]]


def found_with(path: Path, messages: list[RawMessage], site: str = "") -> Discovery:
    return discover_rig(MemoryRecording(messages), Config.model_validate({"rig": {"site_frame": site}}), load_rig(path))


def pixels_of(found: Discovery, name: str, points_site: F64) -> F64:
    camera = next(camera for camera in found.rig.cameras if camera.name == name)
    return camera.model.project(camera.T_camera_site.apply(points_site))[0] - 0.5


# --- Kalibr: the example of https://github.com/ethz-asl/kalibr/wiki/yaml-formats, its second camera with a lens of ours

CAM0: dict[str, Any] = {
    "camera_model": "pinhole",
    "intrinsics": [461.629, 460.152, 362.680, 246.049],
    "distortion_model": "radtan",
    "distortion_coeffs": [-0.27695497, 0.06712482, 0.00087538, 0.00011556],
    "T_cam_imu": [
        [0.01779318, 0.99967549, -0.01822936, 0.07008565],
        [-0.9998017, 0.01795239, 0.00860714, -0.01771023],
        [0.00893160, 0.01807260, 0.99979678, 0.00399246],
        [0.0, 0.0, 0.0, 1.0],
    ],
    "timeshift_cam_imu": -8.121e-05,
    "rostopic": "/cam0/image_raw",
    "resolution": [752, 480],
}
CAM1: dict[str, Any] = {
    "camera_model": "pinhole",
    "intrinsics": [458.655, 457.296, 367.215, 248.375],
    "distortion_model": "equidistant",
    "distortion_coeffs": [-0.01316, 0.05008, -0.04506, 0.01241],
    "T_cn_cnm1": [
        [0.99998854, 0.00216014, 0.00427195, -0.11003785],
        [-0.00221074, 0.99992702, 0.01187697, 0.00045792],
        [-0.00424598, -0.01188627, 0.99992034, -0.00064487],
        [0.0, 0.0, 0.0, 1.0],
    ],
    "rostopic": "/cam1/image_raw",
    "resolution": [752, 480],
}
KALIBRS_PX = (752, 480)
STEREO = [image_message(f"/cam{n}/image_raw", size=KALIBRS_PX) for n in (0, 1)]
IN_VIEW = np.array([[0.3, -0.2, 2.0], [-0.4, 0.1, 1.5], [0.0, 0.3, 4.0]])


def written(path: Path, tree: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(tree))
    return path


def camchain(tmp_path: Path, *cameras: dict[str, Any]) -> Path:
    return written(tmp_path / "results.yaml", {f"cam{number}": camera for number, camera in enumerate(cameras)})


def rigid(rows: Any) -> F64:
    """The matrix of a file, its rounded rotation made a true one by SciPy."""
    matrix = np.array(rows)
    matrix[:3, :3] = Rotation.from_matrix(matrix[:3, :3]).as_matrix()
    return matrix


def matrix_of(intrinsics: Any) -> F64:
    fu, fv, pu, pv = intrinsics
    return np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]])


def test_kalibrs_example(tmp_path: Path) -> None:
    messages = [cloud(frame="velo"), static(("imu", "velo", (0.1, -0.2, 0.3))), *STEREO]
    found = found_with(camchain(tmp_path, CAM0, CAM1), messages)
    assert found.faults == ()
    assert found.rig.site_frame == "imu"
    T_cam0_imu = rigid(CAM0["T_cam_imu"])
    T_cam1_imu = rigid(CAM1["T_cn_cnm1"]) @ T_cam0_imu
    K0, K1 = matrix_of(CAM0["intrinsics"]), matrix_of(CAM1["intrinsics"])
    homogeneous = np.c_[IN_VIEW, np.ones(3)] @ np.linalg.inv(T_cam0_imu).T  # before camera 0, in the IMU's frame
    points = np.ascontiguousarray(homogeneous[:, :3])
    radtan = np.array(CAM0["distortion_coeffs"])
    judge0 = cv2.projectPoints(points, cv2.Rodrigues(T_cam0_imu[:3, :3])[0], T_cam0_imu[:3, 3], K0, radtan)[0]
    np.testing.assert_allclose(pixels_of(found, "cam0", points), judge0[:, 0], atol=0.01)
    fisheye, rotation = np.array(CAM1["distortion_coeffs"]), cv2.Rodrigues(T_cam1_imu[:3, :3])[0]
    judge1 = cv2.fisheye.projectPoints(points[:, None], rotation, T_cam1_imu[:3, 3], K1, fisheye)[0]
    np.testing.assert_allclose(pixels_of(found, "cam1", points), judge1[:, 0], atol=0.01)


def test_kalibrs_chain_without_an_imu_hangs_on_the_first_camera(tmp_path: Path) -> None:
    first = {key: value for key, value in CAM0.items() if key != "T_cam_imu"}
    messages = [cloud(frame="velo"), image_message("/cam0/image_raw", "left", size=KALIBRS_PX), STEREO[1]]
    found = found_with(camchain(tmp_path, first, CAM1), messages)
    assert [fault.sensor for fault in found.faults] == ["cam0", "cam1"]
    assert "its pose refers to cam0" in found.faults[1].reason
    joined = found_with(camchain(tmp_path, first, CAM1), [*messages, static(("velo", "left", (0.5, 0, 0)))])
    assert joined.faults == ()
    one, two = (camera.T_camera_site.matrix for camera in joined.rig.cameras)
    np.testing.assert_allclose(two, rigid(CAM1["T_cn_cnm1"]) @ one, atol=1e-4)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (
            {"camera_model": "omni", "intrinsics": [0.8, 833, 830, 373, 253]},
            "intrinsics are of Kalibr's model omni-radtan in results.yaml, which lidcam cannot project with",
        ),
        ({"distortion_model": "fov", "distortion_coeffs": [0.9]}, "Kalibr's model pinhole-fov"),
    ],
)
def test_other_models_of_kalibr_are_faults(tmp_path: Path, changed: dict[str, Any], reason: str) -> None:
    found = found_with(camchain(tmp_path, CAM0 | changed), [cloud(frame="imu"), STEREO[0]])
    assert reason in found.faults[0].reason


def test_a_camera_of_kalibr_without_distortion_and_an_imu_without_a_place(tmp_path: Path) -> None:
    plain = camchain(tmp_path, CAM0 | {"distortion_model": "none", "distortion_coeffs": None})
    found = found_with(plain, [cloud(frame="imu"), STEREO[0]])
    assert not found.rig.cameras[0].model.distortion.any()
    elsewhere = found_with(plain, [cloud(frame="velo"), STEREO[0]])
    assert "its pose refers to imu" in elsewhere.faults[0].reason
    assert "transforms: {velo: {imu: {translation_m" in elsewhere.faults[0].reason


# --- Autoware


def pose(*values: float) -> dict[str, float]:
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), values, strict=True))


SENSORS = {"base_link": {"sensor_kit_base_link": pose(0.9, 0, 2, -0.001, 0.015, -0.036)}}
VELODYNE = pose(0, 0, 0.5, 0, 0, 1.575)
LINK = pose(0.10731, 0.56343, -0.27697, -0.025, 0.315, 1.035)
KIT = {"sensor_kit_base_link": {"camera0/camera_link": LINK, "velodyne_top": VELODYNE}}


def urdf(pose: dict[str, float]) -> F64:
    """The origin of a URDF joint: fixed axes, roll first."""
    matrix = np.eye(4)
    turns = (Rotation.from_rotvec(np.eye(3)[axis] * pose[key]) for axis, key in enumerate(("roll", "pitch", "yaw")))
    roll, pitch, yaw = turns
    matrix[:3, :3] = (yaw * pitch * roll).as_matrix()
    matrix[:3, 3] = pose["x"], pose["y"], pose["z"]
    return matrix


def test_autowares_files_lead_to_the_sensors(tmp_path: Path) -> None:
    rig = load_rig(written(tmp_path / "both.yaml", SENSORS | KIT)).model_copy(update={"cameras": None})
    assert rig.cameras is None
    K = {"K": [500, 0, 376, 0, 500, 240, 0, 0, 1]}
    camera = load_rig(written(tmp_path / "k.yaml", {"cameras": {"camera0": K}}))
    both = rig.model_copy(update={"cameras": camera.cameras})
    images = image_message("/camera0/image", "camera0/camera_optical_link", size=KALIBRS_PX)
    found = discover_rig(MemoryRecording([cloud(frame="velodyne_top"), images]), Config(), both)
    assert found.faults == ()
    assert found.rig.site_frame == "base_link"
    kit = urdf(SENSORS["base_link"]["sensor_kit_base_link"])
    T_base_lidar = kit @ urdf(VELODYNE)
    np.testing.assert_allclose(found.rig.lidars[0].T_site_lidar.matrix, T_base_lidar, atol=1e-12)
    link = kit @ urdf(LINK)
    T_site_camera = found.rig.cameras[0].T_camera_site.inverse().matrix
    np.testing.assert_allclose(T_site_camera[:3, 2], link[:3, 0], atol=1e-12)  # z of the optical frame is forward
    np.testing.assert_allclose(T_site_camera[:3, 1], -link[:3, 2], atol=1e-12)  # y is down
    np.testing.assert_allclose(T_site_camera[:3, 3], link[:3, 3], atol=1e-12)


def test_the_files_stand_in_place_of_the_recorded_transforms(tmp_path: Path) -> None:
    path = written(tmp_path / "kit.yaml", {"base_link": {"velodyne_top": VELODYNE}})
    recorded = [cloud(frame="velodyne_top"), static(("base_link", "velodyne_top", (9, 9, 9)))]
    found = found_with(path, recorded)
    np.testing.assert_allclose(found.rig.lidars[0].T_site_lidar.translation, [0, 0, 0.5])
    assert found.sources[0].extrinsics == "rig file: base_link <- velodyne_top"
    both = found_with(path, [cloud(frame="scan"), static(("velodyne_top", "scan", (0, 0, 1)))])
    assert both.sources[0].extrinsics == "rig file and tf: base_link <- scan"
    np.testing.assert_allclose(both.rig.lidars[0].T_site_lidar.translation, [0, 0, 1.5])
    optical = "camera0/camera_link", "camera0/camera_optical_link"  # as recorded, not as derived from the file
    kept = found_with(written(path, KIT), [cloud(frame="velodyne_top"), static((*optical, (7, 0, 0)))])
    np.testing.assert_allclose(kept.transforms.fixed.lookup(*optical).translation, [7, 0, 0])


# --- ROS's camera_calibration

TURN = cv2.Rodrigues(np.array([0.02, -0.01, 0.03]))[0]
OST: dict[str, Any] = {
    "image_width": 752,
    "image_height": 480,
    "camera_name": "narrow_stereo/left",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [461.6, 0, 362.6, 0, 460.1, 246.0, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.277, 0.067, 0.0009, 0.0001, 0]},
    "rectification_matrix": {"rows": 3, "cols": 3, "data": TURN.ravel().tolist()},
    "projection_matrix": {"rows": 3, "cols": 4, "data": [400, 0, 370, -48, 0, 400, 250, 0, 0, 0, 1, 0]},
}


@pytest.mark.parametrize(
    ("topic", "size"), [("image_raw", KALIBRS_PX), ("image_rect", KALIBRS_PX), ("image_raw", (376, 240))]
)
def test_a_file_of_camera_calibration_has_both_lenses(tmp_path: Path, topic: str, size: tuple[int, int]) -> None:
    """K and D are those of raw images, R and P those of rectified ones."""
    pose = {"site_frame": "site", "cameras": {"narrow_stereo_left": {"translation_m": [0, 0, 0], "rpy_deg": [0, 0, 0]}}}
    paths = written(tmp_path / "ost.yaml", OST), written(tmp_path / "pose.yaml", pose)
    rig = merge_rigs([(path.name, load_rig(path)) for path in paths])
    images = image_message(f"/narrow_stereo/left/{topic}", size=size)
    found = discover_rig(MemoryRecording([cloud(frame="site"), images]), Config(), rig)
    assert found.faults == ()
    raw_px = cv2.projectPoints(
        IN_VIEW,
        np.zeros(3),
        np.zeros(3),
        matrix_of([461.6, 460.1, 362.6, 246.0]),
        np.array([-0.277, 0.067, 0.0009, 0.0001]),
    )[0][:, 0]
    in_p = IN_VIEW @ TURN.T @ np.reshape(OST["projection_matrix"]["data"], (3, 4))[:, :3].T
    share = size[0] / 752
    judge = in_p[:, :2] / in_p[:, 2:] if "rect" in topic else share * (raw_px + 0.5) - 0.5
    np.testing.assert_allclose(pixels_of(found, "narrow_stereo_left", IN_VIEW), judge, atol=0.01)
    assert found.sources[1].intrinsics.startswith("rig file (")
    assert any("the calibration is scaled" in note for note in found.notes) == (share != 1)


@pytest.mark.parametrize("directive", ["%YAML:1.0", "%YAML 1.2"])
@pytest.mark.parametrize(
    ("count", "fisheye", "model"), [(5, 0, "plumb_bob"), (8, 0, "rational_polynomial"), (4, 1, "equidistant")]
)
def test_a_file_of_opencvs_sample(tmp_path: Path, directive: str, count: int, fisheye: int, model: str) -> None:
    path, distortion = tmp_path / "camera.yml", np.linspace(0.1, 0.2, count)
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (("image_width", 752), ("image_height", 480), ("fisheye_model", fisheye)):
        file.write(key, value)
    file.write("camera_matrix", matrix_of([461.6, 460.1, 362.6, 246.0]))
    file.write("distortion_coefficients", distortion[:, None])
    file.release()
    path.write_text(re.sub("%YAML.*", directive, path.read_text()))  # OpenCV 4 and 5
    pose = {"site_frame": "site", "cameras": {"camera": {"translation_m": [0, 0, 0], "rpy_deg": [0, 0, 0]}}}
    rig = merge_rigs([("camera.yml", load_rig(path)), ("pose.yaml", load_rig(written(tmp_path / "pose.yaml", pose)))])
    images = image_message("/camera/image_raw", size=KALIBRS_PX)
    (camera,) = discover_rig(MemoryRecording([cloud(frame="site"), images]), Config(), rig).rig.cameras
    np.testing.assert_array_equal(camera.model.K, matrix_of([461.6, 460.1, 362.6, 246.0]))
    assert camera.model.model == model
    np.testing.assert_array_equal(camera.model.distortion, distortion)


# --- KITTI


P2, R0 = "P2: 1 0 0 0 0 1 0 0 0 0 1 0\n", "R0_rect: 1 0 0 0 1 0 0 0 1\n"
TR = P2.replace("P2", "Tr_velo_to_cam")


def test_a_singular_projection_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "calib").write_text(f"P2: 0 0 0 0 0 0 0 0 0 0 0 0\n{R0}{TR}")
    found = found_with(
        tmp_path / "calib", [cloud("/points", "site"), image_message("/image_raw_11", size=(640, 480))], "site"
    )
    assert "singular" in found.faults[0].reason


VELO_CLOUD = cloud("/velodyne_points", "velodyne")
KITTI_PX = (1242, 375)


def kitti_object_8(tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """The calibration file of KITTI object frame 8, from the numbers of mmdetection3d's index, and that index."""
    scene = json.loads(shared("data/kitti_object_8/info_from_pkl.json").read_text())["data_list"][0]
    lines = {f"P{n}": np.array(scene["images"][f"CAM{n}"]["cam2img"])[:3] for n in range(4)}
    lines["R0_rect"] = np.array(scene["images"]["R0_rect"])[:3, :3]
    lines["Tr_velo_to_cam"] = np.array(scene["lidar_points"]["Tr_velo_to_cam"])[:3]
    path = tmp_path / "000008.txt"
    path.write_text("".join(f"{name}: {' '.join(map(repr, np.ravel(m).tolist()))}\n" for name, m in lines.items()))
    return path, scene


def test_kitti_object(tmp_path: Path) -> None:
    path, scene = kitti_object_8(tmp_path)
    points = np.fromfile(shared("data/kitti_object_8/000008.bin"), np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
    one = found_with(path, [VELO_CLOUD, image_message("/camera/image_raw", size=KITTI_PX)])
    assert [(c.name, c.topic) for c in one.rig.cameras] == [("cam2", "/camera/image_raw")]
    assert "cam2: has no topic in the rig file; by order it is /camera/image_raw" in one.notes
    found = found_with(path, [VELO_CLOUD, *(image_message(f"/kitti/image_{n}", size=KITTI_PX) for n in range(4))])
    assert {c.name: c.topic for c in found.rig.cameras} == {f"cam{n}": f"/kitti/image_{n}" for n in range(4)}
    for number in range(4):
        judge = np.c_[points, np.ones(len(points))] @ np.array(scene["images"][f"CAM{number}"]["lidar2img"]).T
        np.testing.assert_allclose(pixels_of(found, f"cam{number}", points), judge[:, :2] / judge[:, 2:3], atol=0.01)


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
    R, T = (" ".join(map(repr, np.ravel(part).tolist())) for part in (velo[:, :3], velo[:, 3]))
    velo_to_cam.write_text(f"calib_time: 15-Mar-2012 11:37:16\nR: {R}\nT: {T}\n")
    both = load_rig(cam_to_cam)
    assert both == load_rig(velo_to_cam)
    assert both.cameras is not None
    expected = load_rig(path)
    assert expected.cameras is not None
    np.testing.assert_allclose(both.cameras["cam2"].T_camera_site, expected.cameras["cam2"].T_camera_site)  # type: ignore[arg-type]  # given
    assert (both.cameras["cam2"].width_px, both.cameras["cam2"].height_px) == (1242, 375)


# --- mistakes


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ({"cam0": CAM0 | {"intrinsics": [1, 2, 3]}}, r"cam0\.intrinsics: expected 1 x 4 numbers, found 3"),
        ({"cam0": CAM0 | {"resolution": "large"}}, r"cam0\.resolution: expected 1 x 2"),
        ({"cam0": CAM0 | {"resolution": [float("nan"), 480]}}, r"cam0\.width_px: expected"),
        ({"cam0": CAM0 | {"distortion_coeffs": [1]}}, r"cam0\.distortion_coeffs: expected 1 x 4"),
        ({"cam0": CAM0 | {"T_cam_imu": [[1, 2]]}}, r"cam0\.T_cam_imu: expected 4 x 4"),
        ({"cam0": CAM1}, r"cam0\.T_cn_cnm1: expected a camera before cam0"),
        ({"base_link": {"a": {"x": 1, "y": 2, "z": 3, "roll": 0, "pitch": 0}}}, "unknown key"),
        ({"base_link": {"a": 3}}, "unknown key"),
        ({"base_link": {}}, "unknown key"),
        ({"base_link": KIT["sensor_kit_base_link"], "more": 3}, "unknown key"),
        ({"base_link": {"a": VELODYNE | {"z": "high"}}}, r"base_link\.a: expected 1 x 6 numbers"),
        ({"b": {"a": VELODYNE}, "c": {"a": VELODYNE}}, "a has two parents"),
        (OST | {"camera_matrix": {"data": [1, 2]}}, "file.yaml: camera_matrix: expected 3 x 3 numbers, found 2"),
        (OST | {"projection_matrix": None}, "file.yaml: projection_matrix: expected 3 x 4 numbers"),
        (OST | {"image_width": "wide"}, "cameras.narrow_stereo_left.width_px: expected a whole number"),
        (OST | {"camera_name": "7"}, "cameras.7: expected text of the form"),
        (f"P2: 1 2 3\n{R0}{TR}", "P2: expected 3 x 4 numbers, found 3"),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix\n   data: [ 1. ]\n", "expected image_width, .* of OpenCV, found M1"),
        ('<?xml version="1.0"?>\n<robot name="a"/>\n', "found XML, as a URDF is: write"),
        ('[\n{\n"token": "f4",\n"sensor_token": "47"}]', "found nuScenes' calibrated_sensor.json: write"),
        (P2 + R0, "Tr_velo_to_cam or Tr_velo_cam or Tr, found P2, R0_rect"),
        (R0 + TR, "projections"),
    ],
)
def test_mistakes_in_files(tmp_path: Path, content: dict[str, Any] | str, reason: str) -> None:
    (tmp_path / "file.yaml").write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    with pytest.raises(CalibrationError, match=reason):
        load_rig(tmp_path / "file.yaml")
