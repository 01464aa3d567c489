"""The drawing of objects, the same in every viewer: which are strong, their colours and texts."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F32, F64, Bools, Indices
from pipeline.core.camera import CameraModel
from pipeline.core.detections import Boxes2D, Boxes3D, Matches, Source
from pipeline.core.frame import FrameResult
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.optics.drawn_edges import draw_edges
from writers.palette import CAMERA_ONLY, MATCHED, Rgb, class_color

__all__ = [
    "ARROW_SHARE",
    "ELLIPSE_CORNERS",
    "STRONG_SCORE",
    "DrawnBoxes2D",
    "ObjectEdges",
    "drawn_boxes_2d",
    "ground_ellipses",
    "labels_in_the_clear",
    "object_colors",
    "object_edges",
    "object_labels",
    "placed_objects",
    "strong_objects",
]

ObjectEdges = tuple[F32, Indices]

ARROW_SHARE = 0.75
"""Length of an object's arrow, as a share of the object's: from its centre to a quarter beyond its front."""

STRONG_SCORE = 0.5
FAINTEST = 0.4
"""Brightness of an object of score 0, as a share of its colour."""


ELLIPSE_CORNERS = 48
"""Corners of the polygon that is drawn as an ellipse."""

_ANGLES = np.arange(ELLIPSE_CORNERS) * (2 * np.pi / ELLIPSE_CORNERS)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def strong_objects(result: FrameResult) -> Bools:
    """(N,) which fused objects are drawn strong: a camera confirms them, or their score is high; the rest is faint."""
    return np.asarray((result.fused.matched > 0) | (result.fused.objects.scores >= STRONG_SCORE))


def placed_objects(result: FrameResult) -> Bools:
    """(N,) which fused objects the cameras alone place: they are drawn thinner, and with how sure their place is."""
    return np.asarray(result.fused.objects.sources == Source.CAMERA)


def object_colors(result: FrameResult) -> F64:
    """(N, 3) red, green, blue in [0, 1] of each fused object: its class's, darker the lower its score."""
    objects = result.fused.objects
    colors = np.array([class_color(class_id) for class_id in objects.class_ids.tolist()]).reshape(-1, 3)
    brightness = FAINTEST + (1 - FAINTEST) * np.where(strong_objects(result), 1.0, objects.scores)
    return colors * brightness[:, None]


def object_labels(result: FrameResult, class_names: Sequence[str]) -> list[str]:
    """The text beside each fused object: class, score, how many cameras confirm it, whether no lidar saw it."""
    objects = result.fused.objects
    columns = zip(
        objects.class_ids.tolist(),
        objects.scores.tolist(),
        result.fused.matched.tolist(),
        placed_objects(result).tolist(),
        strict=True,
    )
    return [
        f"{class_names[class_id]} {score:.2f}" + _witnesses(cameras, is_placed=is_placed)
        for class_id, score, cameras, is_placed in columns
    ]


def _witnesses(cameras: int, *, is_placed: bool) -> str:
    parts = [f"{cameras} cam"] * (cameras > 0) + ["no lidar"] * is_placed
    return f" ({', '.join(parts)})" if parts else ""


def object_edges(result: FrameResult, cameras: Iterable[str]) -> dict[str, ObjectEdges]:
    """The fused objects in the images of these cameras, from where they were taken; see `core.optics.drawn_edges`.

    Returns:
        By camera, straight pieces (M, 2, 2) in pixels, object after object, and the row of each one's object (M,).
    """
    objects, views = result.fused.objects, {name: result.views[name] for name in cameras}
    models = [view.model for view in views.values()]
    poses = np.array([view.T_camera_site.matrix[:3] for view in views.values()]).reshape(-1, 3, 4)
    camera, row = np.nonzero(_may_be_seen(objects, models, poses))
    corners = box_corners(objects.centers, objects.sizes, objects.yaws)
    segments, pairs = draw_edges(models, _moved(poses[camera], corners[row]), camera)
    bounds, rows = np.searchsorted(camera[pairs], np.arange(len(views) + 1)).tolist(), row[pairs]
    parts = {name: slice(*bounds[place : place + 2]) for place, name in enumerate(views)}
    return {name: (segments[part], rows[part]) for name, part in parts.items()}


def _moved(poses: F64, points: F64) -> F64:
    """(P, K, 3) points (P, K, 3) in other frames, by transforms (P, 3, 4); to the last bit as `Transform.apply`."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    moved = np.empty(np.broadcast_shapes(points.shape, (len(poses), 1, 1)))
    for axis in range(3):
        a, b, c, shift = (poses[:, axis, column, None] for column in range(4))
        moved[..., axis] = a * x + b * y + c * z + shift
    return moved


def _may_be_seen(objects: Boxes3D, models: Sequence[CameraModel], poses: F64) -> Bools:
    """(C, N) whether the sphere around an object reaches into the cone of what a camera may see.

    Args:
        objects: N objects.
        models: C cameras.
        poses: (C, 3, 4) from the site frame to their optical frames.
    """
    centers = _moved(poses, objects.centers[None])
    radii = np.sqrt((objects.sizes**2).sum(1)) / 2
    distances = np.sqrt((centers**2).sum(2))
    aside = np.arctan2(np.hypot(centers[..., 0], centers[..., 1]), centers[..., 2])
    reach = np.arcsin(np.minimum(radii / np.maximum(distances, radii), 1.0))
    angles = np.array([model.view_angle_rad for model in models]).reshape(-1, 1)
    return np.asarray((distances <= radii) | (aside - reach <= angles))


class DrawnBoxes2D(NamedTuple):
    """The 2D boxes of one image as they are drawn.

    Attributes:
        xyxy: (N, 4) float32, left, top, right, bottom in pixels.
        colors: N colours: that of matched boxes, or of boxes of the camera alone.
        labels: Class and score: the object's where the box belongs to one, else the detector's.
    """

    xyxy: F32
    colors: Sequence[Rgb]
    labels: Sequence[str]


def drawn_boxes_2d(result: FrameResult, camera: str, class_names: Sequence[str]) -> DrawnBoxes2D:
    """The 2D boxes of a camera."""
    boxes: Boxes2D | None = result.detections.cameras.get(camera)
    if boxes is None:
        return DrawnBoxes2D(np.zeros((0, 4), np.float32), (), ())
    objects = result.fused.objects
    object_of_row = {row: index for index, row in enumerate(result.fused.rows.tolist())}
    matches: Matches | None = result.matches.get(camera)
    pairs = matches.pairs.tolist() if matches is not None else []
    object_of_box = {row2d: object_of_row[row3d] for row3d, row2d in pairs if row3d in object_of_row}
    labels = []
    for row, (class_id, score) in enumerate(zip(boxes.class_ids.tolist(), boxes.scores.tolist(), strict=True)):
        if (index := object_of_box.get(row)) is not None:
            class_id, score = int(objects.class_ids[index]), float(objects.scores[index])
        labels.append(f"{class_names[class_id]} {score:.2f}")
    colors = [MATCHED if row in object_of_box else CAMERA_ONLY for row in range(len(boxes))]
    return DrawnBoxes2D(boxes.xyxy, colors, labels)


def labels_in_the_clear(places: F64, sizes: F64, importance: F64) -> list[int]:
    """Rows of labels of which none covers another, the important ones first.

    Args:
        places: (N, 2) x and y of each label's middle.
        sizes: (N, 2) width and height.
        importance: (N,) of two that would cover each other, the more important one stays.
    """
    if len(places) < 2:
        return list(range(len(places)))
    apart = np.asarray((np.abs(places[:, None] - places) > (sizes[:, None] + sizes) / 2).any(2))
    rows, is_free = [], np.ones(len(places), bool)
    for row in np.argsort(-importance, kind="stable").tolist():
        if is_free[row]:
            rows.append(row)
            is_free &= apart[row]
    return rows


def ground_ellipses(boxes: Boxes3D) -> F64:
    """(N, ELLIPSE_CORNERS, 3) points of one standard deviation around the middle of each box's bottom, metres.

    They are the places c + L u of all unit vectors u, where L L^T is the covariance of x and y; all at the middle where
    that is unknown.
    """
    xx, xy, yy = boxes.covariances[:, 0, 0], boxes.covariances[:, 0, 1], boxes.covariances[:, 1, 1]
    along_x = np.sqrt(np.maximum(xx, 0.0))
    shear = np.divide(xy, along_x, out=np.zeros_like(xy), where=along_x > 0)
    along_y = np.sqrt(np.maximum(yy - shear**2, 0.0))
    points = np.repeat(boxes.centers[:, None], ELLIPSE_CORNERS, 1)
    points[..., 0] += along_x[:, None] * _CIRCLE[0]
    points[..., 1] += shear[:, None] * _CIRCLE[0] + along_y[:, None] * _CIRCLE[1]
    points[..., 2] -= boxes.sizes[:, None, 2] / 2
    return points
