"""The rectangles that boxes fill in images, with their derivatives by the boxes.

An edge of the rectangle is where the outermost point of the box appears: a corner, or, where a lens bends lines, a
point of one of the box's edges. For small changes of the box it stays the same point of the box, so the derivative of
the edge is the derivative of that point.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from pipeline.core.arrays import F64, Bools, Rows, check_array
from pipeline.core.camera import NEAR_M
from pipeline.core.lenses import Lenses
from pipeline.core.rig import CameraSensor
from pipeline.fusion.outline import Outline, cuboid_outline

__all__ = ["PARAMETERS", "CameraArrays", "ProjectedEdges", "edges_in_view", "project_edges"]

PARAMETERS = ("x", "y", "yaw", "length", "width", "height", "z")
"""What the derivatives are by, in their order: metres and radians; x, y, z of the centre, in the site frame."""

_AXES = np.array([0, 1, 0, 1])
"""Left, top, right, bottom: which of u and v each edge is."""


@dataclass(frozen=True, eq=False)
class CameraArrays:
    """P cameras as arrays, row by row.

    Attributes:
        rotations: (P, 3, 3) float64, site to camera.
        translations: (P, 3) float64, the site's origin in the optical frames, metres.
        lenses: P lenses.
        image_sizes: (P, 2) float64 width, height, pixels.
    """

    rotations: F64
    translations: F64
    lenses: Lenses
    image_sizes: F64

    def __post_init__(self) -> None:
        n = len(self.rotations)
        check_array("rotations", self.rotations, (n, 3, 3), np.float64)
        check_array("translations", self.translations, (n, 3), np.float64)
        check_array("image_sizes", self.image_sizes, (n, 2), np.float64)

    @classmethod
    def of(cls, cameras: Sequence[CameraSensor]) -> Self:
        """These cameras, in their order."""
        matrices = np.array([camera.T_camera_site.matrix for camera in cameras]).reshape(-1, 4, 4)
        sizes = [(camera.model.width_px, camera.model.height_px) for camera in cameras]
        lenses = Lenses.of([camera.model for camera in cameras])
        return cls(matrices[:, :3, :3], matrices[:, :3, 3], lenses, np.array(sizes, np.float64).reshape(-1, 2))

    def select(self, rows: Rows) -> "CameraArrays":
        """The given rows (mask or indices), in that order."""
        return CameraArrays(
            self.rotations[rows], self.translations[rows], self.lenses.select(rows), self.image_sizes[rows]
        )


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedEdges:
    """Rectangles around P projected boxes, not clipped to the image.

    Attributes:
        xyxy: (P, 4) float64 left, top, right, bottom in pixels.
        jacobian: (P, 4, 7) float64, derivatives of these edges by `PARAMETERS`.
        makers: (P, 4, 3) float64, `Outline.signs` of the point that makes each edge: all are -1 or 1 for a corner.
        valid: (P,) whether the whole box is in front of the camera and within the lens model; other rows are
            meaningless.
    """

    xyxy: F64
    jacobian: F64
    makers: F64
    valid: Bools

    def __post_init__(self) -> None:
        n = len(self.valid)
        check_array("xyxy", self.xyxy, (n, 4), np.float64)
        check_array("jacobian", self.jacobian, (n, 4, len(PARAMETERS)), np.float64)
        check_array("makers", self.makers, (n, 4, 3), np.float64)
        check_array("valid", self.valid, (n,), np.bool_)


def edges_in_view(centers: F64, sizes: F64, yaws: F64, camera: CameraSensor) -> ProjectedEdges:
    """The rectangles of boxes in the image of one camera.

    Args:
        centers: (N, 3) box centres in the site frame, metres.
        sizes: (N, 3) length, width, height, metres.
        yaws: (N,) radians about +z.
        camera: The camera.
    """
    return project_edges(centers, sizes, yaws, CameraArrays.of([camera]).select(np.zeros(len(yaws), np.intp)))


def project_edges(
    centers: F64, sizes: F64, yaws: F64, cameras: CameraArrays, outline: Outline | None = None
) -> ProjectedEdges:
    """The rectangles of boxes, each in the image of its own camera.

    Args:
        centers: (P, 3) box centres in the site frame, metres.
        sizes: (P, 3) length, width, height, metres.
        yaws: (P,) radians about +z.
        cameras: P cameras.
        outline: What is outermost; None: the box itself.
    """
    outline = outline or cuboid_outline(bent=cameras.lenses.bends)
    R, half = cameras.rotations, sizes / 2
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    # The directions of length, width and height, and the centre, in the optical frames.
    along = R[:, :, 0] * cos + R[:, :, 1] * sin
    across = R[:, :, 1] * cos - R[:, :, 0] * sin
    axes = along, across, R[:, :, 2]
    origin = np.einsum("pij,pj->pi", R, centers) + cameras.translations
    # Axis by axis: short strides are quicker.
    points_m = [outline.signs[:, k] * half[:, k, None] + outline.offsets[..., k] for k in range(3)]
    u, v, ahead = _seen(cameras, [_along_axis(points_m, axes, origin, k) for k in range(3)])
    chosen = np.stack([u.argmin(1), v.argmin(1), u.argmax(1), v.argmax(1)], 1)
    rows = np.arange(len(yaws))[:, None]
    makers = outline.signs[chosen]
    reach_m = np.stack([np.broadcast_to(points_m[k], u.shape)[rows, chosen] for k in range(3)], 2)
    made_at = np.stack([_along_axis([*np.moveaxis(reach_m, 2, 0)], axes, origin, k) for k in range(3)], 2)
    pixels, _ = cameras.lenses.project(made_at)
    by_camera = cameras.lenses.jacobians(made_at)[rows, np.arange(4), _AXES]  # (P, 4, 3)
    by_site = np.einsum("pei,pij->pej", by_camera, R)
    by_length = by_site[..., 0] * cos + by_site[..., 1] * sin  # per metre along the box's own axes
    by_width = by_site[..., 1] * cos - by_site[..., 0] * sin
    jacobian = np.empty((len(yaws), 4, len(PARAMETERS)))
    jacobian[..., :2] = by_site[..., :2]
    jacobian[..., 2] = by_width * reach_m[..., 0] - by_length * reach_m[..., 1]
    jacobian[..., 3] = by_length * makers[..., 0] / 2
    jacobian[..., 4] = by_width * makers[..., 1] / 2
    jacobian[..., 5] = by_site[..., 2] * makers[..., 2] / 2
    jacobian[..., 6] = by_site[..., 2]
    return ProjectedEdges(pixels[rows, np.arange(4), _AXES], jacobian, makers, np.asarray(ahead.all(1)))


def _along_axis(points: Sequence[F64], axes: Sequence[F64], origin: F64, k: int) -> F64:
    """(P, S) coordinate k of points with coordinates `points` along the `axes` of boxes around `origin`."""
    x, y, z = points
    return np.asarray(x * axes[0][:, k, None] + y * axes[1][:, k, None] + z * axes[2][:, k, None] + origin[:, k, None])


def _seen(cameras: CameraArrays, points: Sequence[F64]) -> tuple[F64, F64, Bools]:
    """Of (P, S) points what grows with their u, what grows with their v, and whether they are ahead."""
    lenses = cameras.lenses
    if lenses.bends:
        pixels, ahead = lenses.project(np.stack(points, 2))
        return pixels[..., 0], pixels[..., 1], ahead
    x, y, z = points
    ahead = z > NEAR_M / 2
    depth = np.where(ahead, z, 1.0)
    v = y / depth
    u = x / depth
    skew = lenses.K[:, 0, 1] / lenses.K[:, 0, 0]
    return (u + skew[:, None] * v if skew.any() else u), v, ahead
