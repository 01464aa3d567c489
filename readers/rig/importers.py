"""Calibration files of other systems as rig files; the content says which a file is, not its name.

Entries that are missing, or have the wrong number of numbers or none, raise a `CalibrationError`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES
from lidcam.pipeline.core.settings.model import MAX_NUMBER
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.readers.rig.lens import decompose_projection
from lidcam.readers.rig.schema import CameraEntry, LidarEntry, RigFile, parse_rig


def camera_entry(T_camera_site: F64, projection: F64) -> CameraEntry:
    """A camera from its pose (4, 4) and the projection (3, 4) of its frame, which need not be an optical one.

    Matrices that are not valid are kept, and become a fault of the rig, which says why.
    """
    try:
        K, T_optical_camera = decompose_projection("projection", projection)
    except CalibrationError:
        return CameraEntry(P=flat(projection @ T_camera_site))
    return CameraEntry(K=flat(K), T_camera_site=flat(T_optical_camera @ T_camera_site))


def shaped(path: Path, name: str, value: Any, shape: tuple[int, int]) -> F64:
    """Numbers of a file as an array of `shape`."""
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.size != shape[0] * shape[1]:
        raise CalibrationError(f"{path}: {name}: expected {shape[0]} x {shape[1]} numbers, found {matrix.size}")
    return matrix.reshape(shape)


def flat(matrix: F64) -> tuple[float, ...]:
    """Numbers of a matrix, row by row."""
    return tuple(matrix.reshape(-1).tolist())


KITTI_CAMERAS = (2, 3, 0, 1)
"""Colour cameras first: a recording with one camera has the left colour camera, `image_2`."""


_KITTI_LINE = re.compile(
    r"^(P\d|P_rect_\d\d|K_\d\d|Tr|Tr_velo_(to_)?cam|R0_rect|R_rect(_\d\d)?|calib_time):", re.MULTILINE
)


@dataclass(frozen=True, slots=True, eq=False)
class KittiCalibration:
    """The content of a calibration file of KITTI."""

    T_rect_velo: F64  # (4, 4) Velodyne to the rectified frame of camera 0, in which labels stand
    projections: Mapping[int, F64]  # (3, 4) rectified frame to pixels, by number of the camera
    sizes: Mapping[int, tuple[int, int]]  # Width and height in pixels, by number of the camera


def import_kitti(text: str, path: Path) -> RigFile | None:
    """The rectified cameras and the Velodyne, which is the site, of a KITTI file; None if the text has another form.

    Files have P0..P3 (3 x 4, rectified camera 0 to pixel), R0_rect and Tr_velo_to_cam (A. Geiger et al., "Vision meets
    Robotics: The KITTI Dataset", IJRR 2013, equation 8: x = P_i R0_rect Tr_velo_to_cam X). They do not name topics: see
    `assignment`. `text` is the content of `000008.txt` (object), `calib.txt` (odometry), or `calib_cam_to_cam.txt` or
    `calib_velo_to_cam.txt` (raw), each with the other one beside it.
    """
    calibration = kitti_calibration(text, path)
    if calibration is None:
        return None
    cameras = {}
    for number in KITTI_CAMERAS:
        if number not in calibration.projections:
            continue
        entry = camera_entry(calibration.T_rect_velo, calibration.projections[number])
        if size := calibration.sizes.get(number):
            entry = entry.model_copy(update={"width_px": size[0], "height_px": size[1]})
        cameras[f"cam{number}"] = entry
    if not cameras:
        raise CalibrationError(f"{path}: expected projections P0 to P3 or P_rect_00 to P_rect_03, found none")
    velodyne = LidarEntry(T_site_lidar=flat(np.eye(4)))
    return RigFile(site_frame="velodyne", lidars={"velodyne": velodyne}, cameras=cameras)


def kitti_calibration(text: str, path: Path) -> KittiCalibration | None:
    """The content of a KITTI file; None if the text has another form. Arguments and errors as of `import_kitti`."""
    if not _KITTI_LINE.search(text):
        return None
    values = _kitti_values(text, path)
    if "R" in values and "T" in values:
        values |= _kitti_file(path.with_name("calib_cam_to_cam.txt"))
    elif "P_rect_00" in values or "P_rect_02" in values:
        values |= _kitti_file(path.with_name("calib_velo_to_cam.txt"))
    if "R" in values:
        rotation, shift = _kitti_matrix(path, values, ("R",), (3, 3)), _kitti_matrix(path, values, ("T",), (3, 1))
        T_cam0_velo = pose_matrix(rotation, shift[:, 0])
    else:
        T_cam0_velo = np.vstack(
            [_kitti_matrix(path, values, ("Tr_velo_to_cam", "Tr_velo_cam", "Tr"), (3, 4)), [0, 0, 0, 1]]
        )
    T_rect_cam0 = np.eye(4)
    if "Tr" not in values or "R0_rect" in values:  # Tr of odometry leads to the rectified camera
        T_rect_cam0 = pose_matrix(_kitti_matrix(path, values, ("R0_rect", "R_rect", "R_rect_00"), (3, 3)))
    named = {number: (f"P{number}", f"P_rect_0{number}") for number in KITTI_CAMERAS}
    projections = {
        number: _kitti_matrix(path, values, names, (3, 4))
        for number, names in named.items()
        if any(name in values for name in names)
    }
    sizes = {number: values.get(f"S_rect_0{number}", []) for number in projections}
    return KittiCalibration(
        T_rect_cam0 @ T_cam0_velo,
        projections,
        {number: (int(size[0]), int(size[1])) for number, size in sizes.items() if len(size) == 2},
    )


def _kitti_file(path: Path) -> dict[str, list[float]]:
    return _kitti_values(read_small_text(path, MAX_YAML_BYTES, "KITTI calibration", CalibrationError), path)


def _kitti_values(text: str, path: Path) -> dict[str, list[float]]:
    """Numbers by name; lines of words (a date, a comment) are skipped.

    In files of the tracking benchmark, some names have no colon behind them.
    """
    values = {}
    for line in text.splitlines():
        name, separator, words = line.partition(":")
        if not separator:
            name, _, words = line.partition(" ")
        if not words or line.startswith("#"):
            continue
        try:
            values[name.strip()] = [float(word) for word in words.split()]
        except ValueError:
            continue
        if not all(abs(value) <= MAX_NUMBER for value in values[name.strip()]):
            raise CalibrationError(f"{path}: {name.strip()}: expected numbers of {MAX_NUMBER:g} or less in size")
    return values


def _kitti_matrix(path: Path, values: Mapping[str, list[float]], names: tuple[str, ...], shape: tuple[int, int]) -> F64:
    name = next((name for name in names if name in values), None)
    if name is None:
        raise CalibrationError(
            f"{path}: expected a line {' or '.join(names)}, found {', '.join(sorted(values)) or 'none'}"
        )
    return shaped(path, name, values[name], shape)


def import_camera_info(tree: Mapping[str, Any], path: Path) -> RigFile | None:
    """The lens of a file of ROS's camera_calibration (`ost.yaml`), which is a CameraInfo; None for another form.

    The topic of the images says whether they are raw (K and D) or rectified (R and P), as with a recorded CameraInfo.
    The file of OpenCV's calibration sample has the same keys, but no R and P.
    Source: http://wiki.ros.org/camera_calibration_parsers. `narrow_stereo/left` becomes `narrow_stereo_left`.
    """
    if not {"image_width", "image_height", "camera_matrix"} <= set(tree):
        return None
    tree = {"rectification_matrix": {"data": np.eye(3)}, "projection_matrix": {"data": np.zeros(12)}} | dict(tree)
    data = {key: value.get("data") for key, value in tree.items() if isinstance(value, Mapping)}
    coefficients = data.get("distortion_coefficients") or []
    usual_model = "fisheye" if tree.get("fisheye_model") else "plumb_bob"
    info = {
        "distortion_model": str(tree.get("distortion_model", usual_model)),
        "d": flat(shaped(path, "distortion_coefficients", coefficients, (1, np.size(coefficients)))),
        "k": flat(shaped(path, "camera_matrix", data.get("camera_matrix"), (3, 3))),
        "r": flat(shaped(path, "rectification_matrix", data.get("rectification_matrix"), (3, 3))),
        "p": flat(shaped(path, "projection_matrix", data.get("projection_matrix"), (3, 4))),
    }
    size = {"width_px": tree["image_width"], "height_px": tree["image_height"]}
    name = re.sub(r"\W", "_", str(tree.get("camera_name", "camera")).strip("/"), flags=re.ASCII)
    return parse_rig({"cameras": {name: {**size, "camera_info": info}}}, path)


IMU_FRAME = "imu"

DISTORTION_MODELS = {"radtan": "plumb_bob", "equidistant": "equidistant", "none": "plumb_bob"}
"""Models by Kalibr's name."""


def import_kalibr(tree: Mapping[str, Any], path: Path) -> RigFile | None:
    """The cameras of Kalibr's camchain YAML, read from `path`; None if the content has another form.

    Sources: https://github.com/ethz-asl/kalibr/wiki/yaml-formats and /supported-models. Each camera `camN` has
    `camera_model`, `intrinsics` (pinhole: fu fv pu pv), `distortion_model` and `distortion_coeffs` (radtan: k1 k2 r1
    r2, which are OpenCV's k1 k2 p1 p2; equidistant: k1 k2 k3 k4 of Kannala and Brandt, OpenCV's fisheye model),
    `resolution` (width, height) and `rostopic`. `T_cam_imu` takes points from the IMU to the camera, `T_cn_cnm1` those
    from the camera before it in the chain. The frame of the IMU is called `imu`; give its pose as one of `transforms`.
    `timeshift_cam_imu` is not used: it relates the clocks of camera and IMU, not those of camera and lidar.

    Cameras of a model that lidcam cannot project with are kept without intrinsics, and become faults of the rig.
    """
    chain = {
        str(name): camera
        for name, camera in tree.items()
        if isinstance(camera, Mapping) and {"camera_model", "intrinsics"} <= set(camera)
    }
    if not chain:
        return None
    entries: dict[str, dict[str, Any]] = {}
    before = ""
    for name, camera in chain.items():
        entries[name] = _intrinsics(name, camera, path) | _extrinsics(name, camera, before, path)
        before = name
    return parse_rig({"cameras": entries}, path)


def _intrinsics(name: str, camera: Mapping[str, Any], path: Path) -> dict[str, Any]:
    entry: dict[str, Any] = {"topic": camera.get("rostopic") or ""}
    if "resolution" in camera:
        width, height = shaped(path, f"{name}.resolution", camera["resolution"], (1, 2))[0].tolist()
        entry |= {"width_px": width, "height_px": height}
    model, distortion = str(camera["camera_model"]), str(camera.get("distortion_model", "none"))
    if model != "pinhole" or distortion not in DISTORTION_MODELS:
        reason = (
            f"of Kalibr's model {model}-{distortion} in {path.name}, which lidcam cannot project with: calibrate with "
            "pinhole-radtan or pinhole-equi"
        )
        return entry | {"missing": {"K": reason}}
    fu, fv, pu, pv = shaped(path, f"{name}.intrinsics", camera["intrinsics"], (1, 4))[0].tolist()
    coefficients = camera.get("distortion_coeffs") or []
    if distortion != "none":
        coefficients = shaped(path, f"{name}.distortion_coeffs", coefficients, (1, 4))[0].tolist()
    return entry | {
        "K": [fu, 0, pu, 0, fv, pv, 0, 0, 1],
        "distortion_model": DISTORTION_MODELS[distortion],
        "distortion": coefficients,
    }


def _extrinsics(name: str, camera: Mapping[str, Any], before: str, path: Path) -> dict[str, Any]:
    """The pose in the IMU's frame, else in that of the camera before; none for the first camera of a chain alone."""
    if "T_cam_imu" in camera:
        pose = shaped(path, f"{name}.T_cam_imu", camera["T_cam_imu"], (4, 4))
        return {"T_camera_site": flat(pose), "parent": IMU_FRAME}
    if "T_cn_cnm1" in camera:
        if not before:
            raise CalibrationError(f"{path}: {name}.T_cn_cnm1: expected a camera before {name}, found none")
        pose = shaped(path, f"{name}.T_cn_cnm1", camera["T_cn_cnm1"], (4, 4))
        return {"T_camera_site": flat(pose), "parent": before}
    return {}


KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
CAMERA_LINK, OPTICAL_LINK = "camera_link", "camera_optical_link"
OPTICAL_RPY_DEG = (-90.0, 0.0, -90.0)


def import_autoware(tree: Mapping[str, Any], path: Path) -> RigFile | None:
    """The transforms of Autoware's sensors_calibration.yaml or sensor_kit_calibration.yaml; None for another form.

    Each maps a parent frame to child frames, and these to `x`, `y`, `z` (metres) and `roll`, `pitch`, `yaw` (radians):
    the origin of a URDF joint, so the child's position in the parent, and roll about the parent's x, then pitch about
    its y, then yaw about its z. Sources: https://autowarefoundation.github.io/autoware-documentation, "Creating a
    sensor model", and http://wiki.ros.org/urdf/XML/joint (origin). The two files together lead from `base_link` to the
    sensors: `--rig sensors_calibration.yaml --rig sensor_kit_calibration.yaml`.

    Below the frames of the files, Autoware's URDF has one more: of `NAME_link` of a camera, `NAME_optical_link`, turned
    by roll -90 and yaw -90 degrees (tier4/sensor_component_description, monocular_camera.xacro; REP 103), which is
    added here; of `NAME_base_link` of a lidar, `NAME`, at a height that depends on its model, which is not.
    """
    rows = [row for row in tree.values() if isinstance(row, Mapping)]
    poses = [pose for row in rows for pose in row.values()]
    if not poses or len(rows) < len(tree) or not all(isinstance(p, Mapping) and set(p) == {*KEYS} for p in poses):
        return None
    transforms = {
        str(parent): {str(child): _pose(path, f"{parent}.{child}", pose) for child, pose in row.items()}
        for parent, row in tree.items()
    }
    links = [child for row in transforms.values() for child in row if child.endswith(CAMERA_LINK)]
    optical = {link: {link.removesuffix(CAMERA_LINK) + OPTICAL_LINK: {"rpy_deg": OPTICAL_RPY_DEG}} for link in links}
    return parse_rig({"transforms": transforms, "default_transforms": optical}, path)


def _pose(path: Path, name: str, pose: Mapping[str, Any]) -> dict[str, Any]:
    values = shaped(path, name, [pose[key] for key in KEYS], (1, 6))[0].tolist()
    return {"translation_m": values[:3], "rpy_deg": [*map(degrees, values[3:])]}
