"""Boxes and cameras for tests, from plain rows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Matches
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, Rig

# Optical axes (right, down, forward) of a camera that looks along the site's x axis.
LOOK_FORWARD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def boxes3d(
    rows: npt.ArrayLike,
    *,
    scores: npt.ArrayLike | None = None,
    class_ids: npt.ArrayLike | None = None,
    frame_id: str = "site",
    deviations: npt.ArrayLike = (0.1, 2**0.5 / 10, 3**0.5 / 10),
) -> Boxes3D:
    """Boxes from rows x, y, z, length, width, height, yaw; scores 0.5 and class 0 unless given.

    Their standard deviations are those of x, y and yaw.
    """
    table = np.array(rows, np.float64).reshape(-1, 7)
    n = len(table)
    return Boxes3D(
        1,
        frame_id,
        table[:, :3].copy(),
        table[:, 3:6].copy(),
        wrap_angle(table[:, 6]),
        np.full(n, 0.5, np.float32) if scores is None else np.array(scores, np.float32),
        np.zeros(n, np.int32) if class_ids is None else np.array(class_ids, np.int32),
        np.arange(n, dtype=np.int32) + 10,
        np.tile(np.diag(np.square(deviations)), (n, 1, 1)),
        np.zeros(n, np.uint8),
        np.ones(n, np.int64),
    )


def boxes2d(rows: npt.ArrayLike, *, frame_id: str = "cam") -> Boxes2D:
    """Boxes from rows left, top, right, bottom, score, class id."""
    table = np.array(rows, np.float64).reshape(-1, 6)
    return Boxes2D(
        1, frame_id, table[:, :4].astype(np.float32), table[:, 4].astype(np.float32), table[:, 5].astype(np.int32)
    )


def matches(pairs: npt.ArrayLike, projected_xyxy: npt.ArrayLike, *, overlaps: float | Sequence[float] = 0.8) -> Matches:
    """Pairs of rows of 3D and 2D boxes, and the 3D boxes in the image, of which none hides another."""
    rows, xyxy = np.array(pairs, np.int64).reshape(-1, 2), np.array(projected_xyxy, np.float32).reshape(-1, 4)
    iou = np.broadcast_to(np.array(overlaps, np.float32), len(rows)).copy()
    return Matches(rows, iou, xyxy, np.zeros(len(xyxy), np.float32), np.zeros_like(xyxy))


def forward_camera(
    name: str = "cam", *, distortion: Sequence[float] = (), size_px: tuple[int, int] = (640, 480)
) -> CameraSensor:
    """A camera at the site's origin that looks along x, f = 500 px, principal point in the middle of the image."""
    width, height = size_px
    K = np.array([[500.0, 0, width / 2 - 0.5], [0, 500, height / 2 - 0.5], [0, 0, 1]])
    model = CameraModel(name, width, height, K, "plumb_bob", np.array(distortion, np.float64))
    return CameraSensor(name, f"/{name}/image", "", model, Transform(name, "site", LOOK_FORWARD.copy()))


def mounted(camera: CameraSensor, quarters: int) -> CameraSensor:
    """A camera whose images are upright after that many counterclockwise quarter turns, without lens distortion."""
    model, angle = camera.model, np.pi / 2 * quarters
    K, (width_px, height_px) = model.K.copy(), (model.width_px, model.height_px)
    if quarters % 2:
        K[[0, 1], [0, 1]], width_px, height_px = K[[1, 0], [1, 0]], height_px, width_px
    K[:2, 2] = (width_px - 1) / 2, (height_px - 1) / 2
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    extrinsics = replace(camera.T_camera_site, matrix=np.round(turn, 12) @ camera.T_camera_site.matrix)
    lens = CameraModel(model.frame_id, width_px, height_px, K, "plumb_bob", np.zeros(0))
    return replace(camera, model=lens, T_camera_site=extrinsics)


def camera_rig(*cameras: CameraSensor) -> Rig:
    """A rig of cameras; its lidars play no part here."""
    return Rig("site", (), cameras, ())
