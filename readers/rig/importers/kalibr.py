"""Kalibr's camchain YAML.

Sources: https://github.com/ethz-asl/kalibr/wiki/yaml-formats and /supported-models. Each camera `camN` has
`camera_model`, `intrinsics` (pinhole: fu fv pu pv), `distortion_model` and `distortion_coeffs` (radtan: k1 k2 r1 r2,
which are OpenCV's k1 k2 p1 p2; equidistant: k1 k2 k3 k4 of Kannala and Brandt, OpenCV's fisheye model), `resolution`
(width, height) and `rostopic`. `T_cam_imu` takes points from the IMU to the camera, `T_cn_cnm1` those from the camera
before it in the chain. The frame of the IMU is called `imu`; give its pose as one of `transforms`. `timeshift_cam_imu`
is not used: it relates the clocks of camera and IMU, not those of camera and lidar.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.readers.rig.importers.matrices import flat, shaped
from lidcam.readers.rig.schema import RigFile, parse_rig

IMU_FRAME = "imu"

DISTORTION_MODELS = {"radtan": "plumb_bob", "equidistant": "equidistant", "none": "plumb_bob"}
"""Models by Kalibr's name."""


def import_kalibr(tree: Mapping[str, Any], path: Path) -> RigFile | None:
    """The cameras of a camchain, read from `path`; None if the content has another form.

    Cameras of a model that lidcam cannot project with are kept without intrinsics, and become faults of the rig.

    Raises:
        CalibrationError: a value is missing or has the wrong number of numbers.
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
