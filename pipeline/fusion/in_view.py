"""The 3D boxes of a frame in the images of all cameras at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools, check_array
from pipeline.core.camera import NEAR_M
from pipeline.core.detections import Boxes3D
from pipeline.core.errors import FrameError
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.rig import CameraSensor
from pipeline.fusion.projection import CameraArrays, project_edges

__all__ = ["InView", "project_into_views"]


@dataclass(frozen=True, slots=True, eq=False)
class InView:
    """The P pairs of a camera and a box of which it sees some part, ordered by camera, then by box.

    Attributes:
        cameras: (P,) int64 number of the camera.
        rows: (P,) int64 row of the box.
        xyxy: (P, 4) float32 left, top, right, bottom in pixels, clipped to the image.
        jacobian: (P, 4, 3) float64, derivatives of these edges by x, y (metres) and yaw (radians) of the box; zero
            where an edge is the border of the image, or the box reaches behind the camera.
        ranges_m: (P,) float64, distance of the box's centre from the camera.
    """

    cameras: I64
    rows: I64
    xyxy: F32
    jacobian: F64
    ranges_m: F64

    def __post_init__(self) -> None:
        n = len(self.rows)
        check_array("cameras", self.cameras, (n,), np.int64)
        check_array("rows", self.rows, (n,), np.int64)
        check_array("xyxy", self.xyxy, (n, 4), np.float32)
        check_array("jacobian", self.jacobian, (n, 4, 3), np.float64)
        check_array("ranges_m", self.ranges_m, (n,), np.float64)

    def __len__(self) -> int:
        return len(self.rows)


def project_into_views(boxes: Boxes3D, views: Sequence[CameraSensor], arrays: CameraArrays) -> InView:
    """The rectangles of all boxes in all images.

    Args:
        boxes: N boxes in the site frame.
        views: The cameras.
        arrays: The same cameras as arrays.

    Raises:
        FrameError: the boxes are not in the site frame of the cameras.
    """
    for view in views:
        if view.T_camera_site.src != boxes.frame_id:
            raise FrameError(
                f"camera {view.name}: expected boxes in frame {view.T_camera_site.src!r}, found {boxes.frame_id!r}"
            )
    centers_camera = np.einsum("cij,nj->cni", arrays.rotations, boxes.centers) + arrays.translations[:, None]
    radii_m = np.sqrt((boxes.sizes**2).sum(1)) / 2
    cameras, rows = np.nonzero(_may_be_seen(centers_camera, radii_m, arrays))
    edges = project_edges(boxes.centers[rows], boxes.sizes[rows], boxes.yaws[rows], arrays.select(cameras))
    limits = np.tile(arrays.image_sizes[cameras], 2)
    xyxy = np.clip(edges.xyxy, 0.0, limits)
    jacobian = np.where((edges.xyxy == xyxy)[..., None], edges.jacobian[..., :3], 0.0)
    for camera in np.unique(cameras[~edges.valid]):  # boxes beside the camera: cut edges, without derivatives
        cut = ~edges.valid & (cameras == camera)
        corners = box_corners(boxes.centers[rows[cut]], boxes.sizes[rows[cut]], boxes.yaws[rows[cut]])
        xyxy[cut], jacobian[cut] = views[camera].project_boxes(corners, boxes.frame_id), 0.0
    seen = (xyxy[:, 2] > xyxy[:, 0]) & (xyxy[:, 3] > xyxy[:, 1])
    cameras, rows = cameras[seen], rows[seen]
    ranges_m = np.sqrt((centers_camera[cameras, rows] ** 2).sum(1))
    return InView(cameras, rows, xyxy[seen].astype(np.float32), jacobian[seen], ranges_m)


def _may_be_seen(centers_camera: F64, radii_m: F64, arrays: CameraArrays) -> Bools:
    """(C, N) whether the sphere around each box reaches into the view of a camera; lenses that bend see all ahead."""
    seen = centers_camera[..., 2] + radii_m > NEAR_M
    K, limits = arrays.lenses.K, arrays.image_sizes
    straight = ~(arrays.lenses.equidistant | arrays.lenses.coefficients.any(1))
    for axis in (0, 1):
        f, c = K[:, axis, axis], K[:, axis, 2] + 0.5
        skew = K[:, 0, 1] if axis == 0 else np.zeros(len(f))
        # Planes through the camera and one border of the image: f x + s y + (c - border) z = 0, in pixels times metres.
        for border, sign in ((np.zeros(len(f)), 1.0), (limits[:, axis], -1.0)):
            across, other, ahead = sign * f, sign * skew, sign * (c - border)
            length = np.sqrt(across**2 + other**2 + ahead**2)[:, None]
            value = across[:, None] * centers_camera[..., axis] + ahead[:, None] * centers_camera[..., 2]
            if axis == 0:
                value = value + other[:, None] * centers_camera[..., 1]
            seen &= (value + radii_m * length > 0) | ~straight[:, None]
    return seen
