"""The fusion scenes of the predecessor system (`shared/oracles`), with truth."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from detections import boxes2d, boxes3d, camera_rig
from helpers import shared

from lidcam.pipeline.core.arrays import Bools
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, Rig


@dataclass(frozen=True)
class FusionScene:
    """One scene.

    Attributes:
        position_noise_m: Standard deviation of x and y of the lidar's boxes.
        pixel_noise_px: Of the edges of 2D boxes.
        lidar: Boxes as a lidar detector would give them, with the covariance that the noise makes.
        truth: The same without noise.
        seen: 2D boxes by camera.
        judged: (N,) objects that the predecessor matched and did not call truncated.
    """

    position_noise_m: float
    pixel_noise_px: float
    lidar: Boxes3D
    truth: Boxes3D
    seen: Mapping[str, Boxes2D]
    judged: Bools


def scene_rig(calibration: Mapping[str, Any]) -> Rig:
    """Cameras from 3 x 4 matrices K [R | t]; these count pixels from the corner of the image as lidcam's boxes do."""
    width, height, f = calibration["W"], calibration["H"], calibration["f"]
    corner_K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
    center_K = corner_K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    cameras = []
    for number, P in enumerate(np.array(calibration["P"], np.float64), start=1):
        matrix = np.eye(4)
        matrix[:3] = np.linalg.solve(corner_K, P)
        model = CameraModel(f"{number}", width, height, center_K.copy(), "plumb_bob", np.zeros(0))
        cameras.append(CameraSensor(f"{number}", "", "", model, Transform(f"{number}", "site", matrix)))
    return camera_rig(*cameras)


def fusion_scenes() -> tuple[Rig, list[FusionScene]]:
    """The rig and all scenes; skips the test where they are absent."""
    oracle = json.loads(shared("oracles/fusion/scenes.json").read_text())
    rig = scene_rig(oracle["calibration"])
    return rig, list(_scenes(oracle, rig))


def _scenes(oracle: Mapping[str, Any], rig: Rig) -> Iterator[FusionScene]:
    for case in oracle["cases"]:
        params = case["params"]
        noise = np.array([params["pos_noise"], params["pos_noise"], params["yaw_noise"]], np.float64)
        judged = np.zeros(len(case["boxes3d"]), np.bool_)
        for (_, row, *_), truncated in zip(case["seed_match"], case["seed_truncated"], strict=True):
            judged[row] |= not truncated
        yield FusionScene(
            params["pos_noise"],
            params["px_noise"],
            boxes3d(case["boxes3d"], scores=case["scores3d"], deviations=noise),
            boxes3d(case["gt_boxes3d"]),
            {camera.name: boxes2d(rows) for camera, rows in zip(rig.cameras, case["boxes2d"], strict=True)},
            judged,
        )
