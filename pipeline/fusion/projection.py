"""The rectangles that boxes fill in images, with their derivatives by the boxes.

An edge of the rectangle is where the outermost point of the box appears: a corner, or, where a lens bends lines, a
point of one of the box's edges. For small changes of the box it stays the same point of the box, so the derivative of
the edge is the derivative of that point.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import NamedTuple, Self

import numpy as np

from pipeline.core.arrays import F64, Bools, Indices, Rows, check_array, select_rows
from pipeline.core.geometry.box_edges import BOX_EDGES
from pipeline.core.geometry.boxes import UNIT_CORNERS
from pipeline.core.optics.lenses import Lenses
from pipeline.core.optics.outlines import outermost_points
from pipeline.core.rig import CameraSensor

__all__ = [
    "PARAMETERS",
    "CameraArrays",
    "Outline",
    "ProjectedEdges",
    "camera_arrays",
    "cuboid_outline",
    "project_edges",
]

PARAMETERS = ("x", "y", "yaw", "length", "width", "height", "z")
"""What the derivatives are by, in their order: metres and radians; x, y, z of the centre, in the site frame."""


_BETWEEN = np.array([0.25, 0.5, 0.75])[:, None]
_ALONG_EDGES = np.concatenate(
    [UNIT_CORNERS, *(UNIT_CORNERS[a] * (1 - _BETWEEN) + UNIT_CORNERS[b] * _BETWEEN for a, b in BOX_EDGES)]
)
"""Corners, and where lines are bent the samples of edges that `CameraModel.project_boxes` uses."""


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """Points of P objects, along the axes of their boxes.

    A point is at `signs * size / 2 + offsets`: it keeps its distance to the sides of the box when the box grows.

    Attributes:
        signs: (S, 3) float64 in [-1, 1].
        offsets: (P, S, 3) float64 metres; P may be 1 if they are the same for all.
    """

    signs: F64
    offsets: F64

    def __post_init__(self) -> None:
        check_array("signs", self.signs, (len(self.signs), 3), np.float64)
        check_array("offsets", self.offsets, (len(self.offsets), len(self.signs), 3), np.float64)

    def select(self, rows: Rows) -> "Outline":
        """The outlines of the given objects (mask or indices), in that order."""
        return self if len(self.offsets) == 1 else Outline(self.signs, self.offsets[rows])


@cache
def cuboid_outline(*, bent: bool) -> Outline:
    """The corners of boxes; if a lens bends lines, points of their edges, too."""
    points = _ALONG_EDGES if bent else UNIT_CORNERS
    return Outline(points, np.zeros((1, len(points), 3)))


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
        rotations, translations = matrices[:, :3, :3].copy(), matrices[:, :3, 3].copy()
        return cls(rotations, translations, lenses, np.array(sizes, np.float64).reshape(-1, 2))

    def select(self, rows: Rows) -> "CameraArrays":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)

    @cached_property
    def positions(self) -> F64:
        """(P, 3) the cameras, metres in the site frame."""
        return np.asarray(-(self.rotations * self.translations[:, :, None]).sum(1))

    @cached_property
    def limits(self) -> F64:
        """(P, 4) the largest left, top, right and bottom of what lies in the image: its size, twice."""
        return np.concatenate([self.image_sizes, self.image_sizes], 1)


@lru_cache(maxsize=4)
def camera_arrays(cameras: tuple[CameraSensor, ...]) -> CameraArrays:
    """These cameras as arrays, which are made once for those that stand still, and once a frame for others."""
    return CameraArrays.of(cameras)


class ProjectedEdges(NamedTuple):
    """Rectangles around P projected boxes, not clipped to the image.

    Attributes:
        xyxy: (P, 4) float64 left, top, right, bottom in pixels.
        jacobian: (P, 4, 7) float64, derivatives of these edges by `PARAMETERS`.
        valid: (P,) whether the whole box is in front of the camera and within the lens model; other rows are
            meaningless.
    """

    xyxy: F64
    jacobian: F64
    valid: Bools


def project_edges(
    centers: F64,
    sizes: F64,
    yaws: F64,
    cameras: CameraArrays,
    outline: Outline | None = None,
    *,
    rows: Indices | None = None,
) -> ProjectedEdges:
    """The rectangles of boxes, each in the image of its own camera.

    Args:
        centers: (P, 3) box centres in the site frame, metres.
        sizes: (P, 3) length, width, height, metres.
        yaws: (P,) radians about +z.
        cameras: P cameras, or those that `rows` refer to.
        outline: What is outermost, for as many objects as cameras; None: the box itself.
        rows: (P,) camera and outline of each box; None: each has its own.
    """
    outline = outline or cuboid_outline(bent=cameras.lenses.bends)
    rows = np.arange(len(yaws)) if rows is None else rows
    xyxy, jacobian, _, valid = outermost_points(
        np.ascontiguousarray(centers),
        np.ascontiguousarray(sizes),
        np.cos(yaws),
        np.sin(yaws),
        rows,
        outline.signs,
        outline.offsets,
        cameras.rotations,
        cameras.translations,
        *cameras.lenses.arrays,
    )
    return ProjectedEdges(xyxy, jacobian, valid)
