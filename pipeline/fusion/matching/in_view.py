"""The 3D boxes of a frame in the images of all cameras at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools
from pipeline.core.camera import NEAR_M
from pipeline.core.detections import Boxes3D
from pipeline.core.errors import FrameError
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.rig import CameraSensor
from pipeline.fusion.matching.in_view_kernels import clipped_edges, in_pyramids, seen_from
from pipeline.fusion.outline import cuboid_outline
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
    centers_camera = seen_from(boxes.centers, arrays.rotations, arrays.translations)
    radii_m = np.sqrt((boxes.sizes**2).sum(1)) / 2
    if arrays.lenses.bends:
        angles = np.array([view.model.view_angle_rad for view in views])
        near = _in_cones(centers_camera, radii_m, angles)
    else:
        near = in_pyramids(centers_camera, radii_m, *_pyramids(arrays), NEAR_M)
    cameras, rows = (np.ascontiguousarray(pairs) for pairs in near.nonzero())
    placed = boxes.centers.take(rows, 0), boxes.sizes.take(rows, 0), boxes.yaws.take(rows)
    outline = cuboid_outline(bent=bool(arrays.lenses.bent[cameras].any()))
    edges = project_edges(*placed, arrays, outline, rows=cameras)
    xyxy, jacobian, cut = clipped_edges(edges.xyxy, edges.jacobian, edges.valid, cameras, arrays.image_sizes)
    if len(cut):  # boxes beside the camera: cut edges, without derivatives
        xyxy[cut] = _cut_rectangles(box_corners(*(array[cut] for array in placed)), arrays.select(cameras[cut]))
    shown = (xyxy[:, 2] > xyxy[:, 0]) & (xyxy[:, 3] > xyxy[:, 1])
    if not shown.all():
        cameras, rows, xyxy, jacobian = cameras[shown], rows[shown], xyxy[shown], jacobian[shown]
    ranges_m = np.sqrt((centers_camera[cameras, rows] ** 2).sum(1))
    return InView(cameras, rows, xyxy.astype(np.float32), jacobian, ranges_m)


def _cut_rectangles(corners: F64, cameras: CameraArrays) -> F32:
    """(P, 4) rectangles around boxes, of which a part may be behind the camera, as `CameraModel.project_boxes`."""
    x, y, z = (corners[..., axis, None] for axis in range(3))
    R, t = cameras.rotations[:, None], cameras.translations[:, None]
    ahead = R[..., 0] * x + R[..., 1] * y + R[..., 2] * z + t
    return cameras.lenses.rectangles_of_boxes(ahead, cameras.image_sizes).astype(np.float32)


def _in_cones(centers_camera: F64, radii_m: F64, angles_rad: F64) -> Bools:
    """(C, N) whether the sphere around each box reaches into the cone that a camera sees."""
    x, y, z = np.moveaxis(centers_camera, -1, 0)
    range_m = np.sqrt(x * x + y * y + z * z)
    reach = np.where(range_m > radii_m, np.arcsin(radii_m / np.maximum(np.maximum(range_m, radii_m), 1e-9)), np.pi)
    aside = np.arctan2(np.sqrt(x * x + y * y), z)
    return np.asarray((z + radii_m > NEAR_M) & (aside - reach < angles_rad[:, None]))


@lru_cache(maxsize=4)
def _pyramids(arrays: CameraArrays) -> tuple[F64, F64]:
    """(C, 4, 3) planes through each camera and each border of its image, positive inside, and (C, 4) their lengths."""
    K = arrays.lenses.K[:, :2]
    left_top, right_bottom = K.copy(), -K
    left_top[..., 2] += 0.5
    right_bottom[..., 2] += arrays.image_sizes - 0.5
    planes = np.concatenate([left_top, right_bottom], 1)
    return planes, np.sqrt((planes * planes).sum(2))
