"""The rectangles that boxes fill in images, with their derivatives by the boxes.

An edge of the rectangle is at the outermost point of the box: a corner, or, where a lens bends lines, a point of one of
the box's edges. For small changes of the box it stays the same point, so its derivative is that of the edge.

A cuboid around an object appears larger than the object: vehicles and people have round corners, and do not touch the
ground at the corners of their box. Seen across a corner, the rectangle around a projected cuboid is wider than the one
around the object by a fifth of the radius of the corner and more, on both sides. `rounded_outline` rounds the corners.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import ClassVar, NamedTuple, Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools, CheckedTable, Indices, Rows, check_array
from lidcam.pipeline.core.geometry.box_edges import BOX_EDGES
from lidcam.pipeline.core.geometry.boxes import UNIT_CORNERS
from lidcam.pipeline.core.optics.lenses import Lenses
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.native.kernels import outermost_points

PARAMETERS = ("x", "y", "yaw", "length", "width", "height", "z")
"""Parameters of the derivatives, in order: metres and radians; x, y, z of the centre, in the site frame."""

_BETWEEN = np.array([0.25, 0.5, 0.75])[:, None]
_ALONG_EDGES = np.concatenate(
    [UNIT_CORNERS, *(UNIT_CORNERS[a] * (1 - _BETWEEN) + UNIT_CORNERS[b] * _BETWEEN for a, b in BOX_EDGES)]
)
"""Corners, and where lines are bent the samples of edges that `CameraModel.project_boxes` uses."""

_INWARD = np.array([[0.0, 1.0], [1.0, 0.0]])
"""Ends of the straight line in place of a round corner, in units of its cut on both sides."""

CUT_PER_RADIUS = np.sqrt(2) * (np.sqrt(2) - 1)
"""Cut of a straight corner that appears as far inside, seen across it, as a rounded one, per radius."""

_LEVELS = (-1.0, 0.2, 1.0)
"""Underside, belt line of a car, roof, in halves of the height."""

MAX_CAR_HEIGHT = 1.2
"""Maximum ratio of height to width of a car."""

CORNER_ROUNDING = 0.25
"""Radius of the corners of a car seen from above, as a share of its width."""

UNDERSIDE = 0.06
"""Height of the outline's lower edge above the ground, as a share of the object's height."""

CABIN = 0.4
"""Amount by which the roof of a car is shorter and narrower than its body, as a share."""

MIN_PERSON_HEIGHT = 2.0
"""Minimum ratio of height to width of a person."""

TALL_ROUNDING = 0.4
"""Rounding of vans, trucks and buses, as a share of that of cars."""

MIN_RIDER_LENGTH = 2.0
"""Minimum ratio of length to width of a person who rides."""

_WHEEL_END, _WHEEL_GROUND, _HANDS, _HEAD = (1.0, 0.1, -0.6), (0.6, 0.1, -1.0), (0.2, 1.0, 0.25), (0.15, 0.3, 1.0)
"""Points of a rider along, across and up, in halves of the box: the end of a wheel at the height of its axle and on the
ground, hands and shoulders, and the head."""

_SIDES = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """Points of P objects, along the axes of their boxes.

    A point is at `signs * size / 2 + offsets`: it keeps its distance to the sides of the box when the box grows.
    """

    signs: F64  # (S, 3) float64 in [-1, 1]
    offsets: F64  # (P, S, 3) float64 metres; P may be 1 if they are the same for all

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


def rounded_outline(sizes: F64, *, bent: bool) -> Outline:
    """Boxes (P, 3) with round corners, seen from above, and a roof that is smaller than the body; `bent`: by a lens.

    Objects that are higher than wide by `MIN_PERSON_HEIGHT` are people: round on foot, and with thin wheels in front
    and behind if they ride. Cars are objects that are lower than wide; from `MAX_CAR_HEIGHT` on there is no such roof.
    """
    signs, inward, of_riders = _round_points(bent=bent)
    smaller, height = sizes[:, :2].min(1), sizes[:, 2]
    is_upright = height > MIN_PERSON_HEIGHT * smaller
    low = ((MAX_CAR_HEIGHT - height / sizes[:, 1]) / (MAX_CAR_HEIGHT - 1)).clip(0.0, 1.0)
    share = np.where(is_upright, 0.5, CORNER_ROUNDING * (TALL_ROUNDING + (1 - TALL_ROUNDING) * low))
    offsets = np.zeros((len(sizes), len(signs), 3))
    offsets[..., :2] = inward * (CUT_PER_RADIUS * share * smaller)[:, None, None]
    roof = signs[:, 2] == 1
    offsets[:, roof, :2] -= signs[roof, :2] * (CABIN * low[:, None] * sizes[:, :2] / 2)[:, None]
    offsets[:, signs[:, 2] < 0, 2] = (UNDERSIDE * height)[:, None]
    rides = is_upright & (sizes[:, 0] > MIN_RIDER_LENGTH * sizes[:, 1])
    offsets[rides] = of_riders * sizes[rides, None] / 2
    return Outline(signs, offsets)


@cache
def _round_points(*, bent: bool) -> tuple[F64, F64, F64]:
    """Points of boxes with round corners.

    Returns:
        (S, 3) signs; (S, 2) displacement of each point for a corner cut by 1; (S, 3) offsets, in halves of the box, for
        people on bicycles: thin wheels at the ends, a rider in the middle, a head on top.
    """
    corners = np.repeat(UNIT_CORNERS[:4, :2], len(_INWARD), axis=0)
    inward = np.tile(_INWARD, (4, 1))
    around = np.concatenate([corners, _SIDES]) if bent else corners
    inward = np.concatenate([inward, np.zeros_like(_SIDES)]) if bent else inward
    signs = np.concatenate([np.column_stack([around, np.full(len(around), level)]) for level in _LEVELS])
    inward = np.tile(inward, (len(_LEVELS), 1))
    place = np.where(inward[:, 1:] > 0, _WHEEL_END, _HANDS)
    place = np.where(signs[:, 2:] < 0, _WHEEL_GROUND, np.where(signs[:, 2:] == 1, _HEAD, place))
    place[:, :2] *= signs[:, :2]
    return signs, -np.sign(signs[:, :2]) * inward, place - signs


@dataclass(frozen=True, eq=False)
class CameraArrays(CheckedTable):
    """P cameras as arrays, row by row."""

    ROWS: ClassVar = {"rotations": (3, 3), "translations": (3,), "image_sizes": (2,)}

    rotations: F64  # (P, 3, 3) float64, site to camera
    translations: F64  # (P, 3) float64, the site's origin in the optical frames, metres
    lenses: Lenses  # P lenses
    image_sizes: F64  # (P, 2) float64 width, height, pixels

    @classmethod
    def of(cls, cameras: Sequence[CameraSensor]) -> Self:
        """These cameras, in their order."""
        matrices = np.array([camera.T_camera_site.matrix for camera in cameras]).reshape(-1, 4, 4)
        sizes = [(camera.model.width_px, camera.model.height_px) for camera in cameras]
        lenses = Lenses.of([camera.model for camera in cameras])
        rotations, translations = matrices[:, :3, :3].copy(), matrices[:, :3, 3].copy()
        return cls(rotations, translations, lenses, np.array(sizes, np.float64).reshape(-1, 2))

    @cached_property
    def positions(self) -> F64:
        """(P, 3) the cameras, metres in the site frame."""
        return np.asarray(-(self.rotations * self.translations[:, :, None]).sum(1))

    @cached_property
    def limits(self) -> F64:
        """(P, 4) maximum left, top, right and bottom in the image: its size, twice."""
        return np.concatenate([self.image_sizes, self.image_sizes], 1)


@lru_cache(maxsize=4)
def camera_arrays(cameras: tuple[CameraSensor, ...]) -> CameraArrays:
    """These cameras as arrays, cached for cameras that stand still."""
    return CameraArrays.of(cameras)


class ProjectedEdges(NamedTuple):
    """Rectangles around P projected boxes, not clipped to the image."""

    xyxy: F64  # (P, 4) float64 left, top, right, bottom in pixels
    jacobian: F64  # (P, 4, 7) float64, derivatives of these edges by `PARAMETERS`
    # (P,) whether the whole box is in front of the camera and within the lens model; other rows are meaningless
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
        outline: An outline for each camera; None: the corners of the boxes.
        rows: (P,) camera and outline of each box; None: one for each box.
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
