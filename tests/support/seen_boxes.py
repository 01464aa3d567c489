"""2D boxes that cameras would find of known 3D boxes."""

from collections.abc import Mapping, Sequence

import numpy as np
from detections import boxes2d

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel, DistortionModel
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.projection import CameraArrays, ProjectedEdges, project_edges

Box = tuple[float, float, float, float, float, float, float]
"""x, y, z of the centre, length, width, height, yaw."""


def camera_at(
    name: str,
    position: tuple[float, float, float],
    *,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    model: DistortionModel = "plumb_bob",
    distortion: Sequence[float] = (),
) -> CameraSensor:
    """A camera of 1280 x 720 px, f = 900 px, that looks along `yaw_deg`, and down by `pitch_deg`."""
    yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    turn = np.array([right, np.cross(forward, right), forward])
    K = np.array([[900.0, 0, 639.5], [0, 900, 359.5], [0, 0, 1]])
    lens = CameraModel(name, 1280, 720, K, model, np.array(distortion, np.float64))
    return CameraSensor(name, f"/{name}", "", lens, Transform(name, "site", pose_matrix(turn, -turn @ position)))


def seen_by(camera: CameraSensor, boxes: Sequence[Box], class_ids: Sequence[int], *, score: float = 0.8) -> Boxes2D:
    """The rectangles around those of the boxes that the camera has in view."""
    table = np.array(boxes, np.float64).reshape(-1, 7)
    rectangles = camera.model.project_boxes(
        camera.T_camera_site.apply(box_corners(table[:, :3], table[:, 3:6], table[:, 6]))
    )
    rows = [
        (*rectangle, score, class_id)
        for rectangle, class_id in zip(rectangles.tolist(), class_ids, strict=True)
        if np.isfinite(rectangle[0])
    ]
    return boxes2d(rows, frame_id=camera.name)


def edges_in_view(centers: F64, sizes: F64, yaws: F64, camera: CameraSensor) -> ProjectedEdges:
    """The rectangles of boxes in the image of one camera, and their derivatives."""
    return project_edges(centers, sizes, yaws, CameraArrays.of([camera]), rows=np.zeros(len(yaws), np.intp))


def views_of(*cameras: CameraSensor) -> Mapping[str, CameraSensor]:
    """By name."""
    return {camera.name: camera for camera in cameras}
