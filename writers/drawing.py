"""The drawing of objects, the same in every viewer: which are strong, their colours and texts."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, Indices
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import NO_HYPOTHESIS, Boxes2D, Boxes3D, Matches, Source
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.optics.drawn_edges import draw_edges
from lidcam.pipeline.core.optics.lenses import may_show
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.writers.palette import CAMERA_ONLY, MATCHED, Rgb, class_color

ObjectEdges = tuple[F32, Indices]

ARROW_SHARE = 0.75
"""Length of the arrow of an object that stands, as a share of the object's: from its centre to a quarter beyond it."""

ARROW_S = 1.0
"""The arrow of an object that moves reaches as much farther as it moves ahead in this time."""

STRONG_SCORE = 0.5
FAINTEST = 0.4
"""Brightness of an object of score 0, as a share of its colour."""

STANDING_M_S = 0.05
"""Below this no speed is written."""

PREDICTED_SHARE = 0.65
"""Brightness of an object that is predicted, as a share of that of one that is seen."""

ELLIPSE_CORNERS = 48
"""Corners of the polygon that is drawn as an ellipse."""

_MISSING = {Source.CAMERA: "no lidar", Source.PREDICTED: "predicted"}
_ANGLES = np.arange(ELLIPSE_CORNERS) * (2 * np.pi / ELLIPSE_CORNERS)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def strong_objects(result: FrameResult) -> Bools:
    """(N,) which fused objects are drawn strong: a camera confirms them, or their score is high."""
    return np.asarray((result.fused.matched > 0) | (result.fused.objects.scores >= STRONG_SCORE))


def camera_image(result: FrameResult, camera: CameraSensor) -> RawMessage | None:
    """The image of a camera in a frame; None where there is none, or a stage found it unfit."""
    message = result.bundle.messages.get(camera.topic)
    unfit = {(drop.topic, drop.stamp_ns) for drop in result.drops}
    return None if message is None or (message.topic, message.stamp_ns) in unfit else message


@dataclass(frozen=True, slots=True, eq=False)
class DrawnObjects:
    """The N fused objects of a frame, as every viewer draws them."""

    result: FrameResult  # The frame
    boxes: Boxes3D  # Its fused objects
    class_names: Sequence[str]  # By class id
    tracks: I64  # (N,) number of the track of each; `NO_TRACK` without
    strong: Bools  # (N,) confirmed by a camera, or with a high score; the others are faint
    predicted: Bools  # (N,) shown by nothing in the frame: they are where their tracks say
    thin: Bools  # (N,) shown by no lidar: drawn thinner, and with the uncertainty of their place
    colors: F64  # (N, 3) red, green, blue in [0, 1]: that of the class, darker where unsure or predicted
    names: Sequence[str]  # Class, number and speed of those with a track; class and score of the others
    # The same with what is missing: `car #12, 4.3 m/s`, `car 0.82 (2 cam)`, `car 0.31 (no lidar)`
    labels: Sequence[str]

    @classmethod
    def of(cls, result: FrameResult, class_names: Sequence[str]) -> Self:
        """The objects of one frame."""
        boxes, tracks, cameras = result.fused.objects, result.fused.tracks, result.fused.matched
        strong = strong_objects(result)
        predicted = np.asarray(boxes.sources == Source.PREDICTED)
        colors = np.array([class_color(class_id) for class_id in boxes.class_ids.tolist()]).reshape(-1, 3)
        brightness = FAINTEST + (1 - FAINTEST) * np.where(strong, 1.0, boxes.scores)
        brightness *= np.where(predicted, PREDICTED_SHARE, 1.0)
        numbers = np.full(len(boxes), NO_TRACK, np.int64) if tracks is None else tracks.ids
        speeds_m_s = np.zeros(len(boxes)) if tracks is None else tracks.speeds
        names, labels = [], []
        columns = (boxes.class_ids, boxes.scores, numbers, speeds_m_s, cameras, boxes.sources)
        for class_id, score, number, speed_m_s, count, source in zip(*(c.tolist() for c in columns), strict=True):
            remarks = [_MISSING[source]] if source in _MISSING else []
            if number == NO_TRACK:
                names.append(f"{class_names[class_id]} {score:.2f}")
                remarks = [f"{count} cam"] * (count > 0) + remarks
            else:
                speed = f", {speed_m_s:.1f} m/s" if speed_m_s >= STANDING_M_S else ""
                names.append(f"{class_names[class_id]} #{number}{speed}")
            labels.append(names[-1] + (f" ({', '.join(remarks)})" if remarks else ""))
        return cls(
            result=result,
            boxes=boxes,
            class_names=class_names,
            tracks=numbers,
            strong=strong,
            predicted=predicted,
            thin=np.asarray((boxes.sources == Source.CAMERA) | predicted),
            colors=colors * brightness[:, None],
            names=names,
            labels=labels,
        )

    @property
    def roofs(self) -> F64:
        """(N, 3) the middle of the top of each box."""
        return self.boxes.centers + [0.0, 0.0, 0.5] * self.boxes.sizes

    @property
    def arrow_lengths_m(self) -> F64:
        """(N,) lengths of the arrows along the headings; 0 where no motion has shown which end is the front."""
        boxes, tracks = self.boxes, self.result.fused.tracks
        if tracks is None:
            return np.zeros(len(boxes))
        ahead = tracks.velocities[:, 0] * np.cos(boxes.yaws) + tracks.velocities[:, 1] * np.sin(boxes.yaws)
        lengths = ARROW_SHARE * boxes.sizes[:, 0] + ARROW_S * np.maximum(ahead, 0.0)
        return np.where(tracks.fronts_known, lengths, 0.0)


def object_edges(result: FrameResult, cameras: Iterable[str]) -> dict[str, ObjectEdges]:
    """The fused objects in the images of these cameras, from where they were taken; see `core.optics.drawn_edges`.

    Returns:
        By camera, straight pieces (M, 2, 2) in pixels, object after object, and the row of each one's object (M,).
    """
    objects, views = result.fused.objects, {name: result.views[name] for name in cameras}
    models = [view.model for view in views.values()]
    poses = np.array([view.T_camera_site.matrix[:3] for view in views.values()]).reshape(-1, 3, 4)
    radii_m = np.sqrt((objects.sizes**2).sum(1)) / 2
    camera, row = np.nonzero(may_show(models, _moved(poses, objects.centers[None]), radii_m))
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


class DrawnBoxes2D(NamedTuple):
    """The 2D boxes of one image as they are drawn."""

    xyxy: F32  # (N, 4) float32, left, top, right, bottom in pixels
    colors: Sequence[Rgb]  # N colours: that of matched boxes, or of boxes of the camera alone
    # Class and score, or track and speed: the object's where the box belongs to one, else the detector's
    labels: Sequence[str]
    objects: Sequence[int] = ()  # Row of that object, -1 where the box belongs to none
    overlaps: Sequence[float] = ()  # With its 3D box, when they were matched; 0 where the box belongs to none

    @property
    def are_matched(self) -> Bools:
        """(N,) which belong to an object: its 3D box is drawn as well, so they are fainter."""
        return np.array([color == MATCHED for color in self.colors], np.bool_)


def drawn_boxes_2d(drawn: DrawnObjects, camera: str) -> DrawnBoxes2D:
    """The 2D boxes of a camera."""
    result = drawn.result
    boxes: Boxes2D | None = result.detections.cameras.get(camera)
    if boxes is None:
        return DrawnBoxes2D(np.zeros((0, 4), np.float32), (), ())
    object_of_row = {row: index for index, row in enumerate(result.fused.rows.tolist()) if row != NO_HYPOTHESIS}
    matches: Matches | None = result.matches.get(camera)
    pairs = zip(matches.pairs.tolist(), matches.iou.tolist(), strict=True) if matches is not None else ()
    of_box = {row2d: (object_of_row[row3d], iou) for (row3d, row2d), iou in pairs if row3d in object_of_row}
    found = [of_box.get(row, (-1, 0.0)) for row in range(len(boxes))]
    labels = []
    for (index, _), class_id, score in zip(found, boxes.class_ids.tolist(), boxes.scores.tolist(), strict=True):
        labels.append(drawn.names[index] if index >= 0 else f"{drawn.class_names[class_id]} {score:.2f}")
    colors = [MATCHED if index >= 0 else CAMERA_ONLY for index, _ in found]
    return DrawnBoxes2D(boxes.xyxy, colors, labels, [index for index, _ in found], [iou for _, iou in found])


def with_outlines(drawn: DrawnBoxes2D, objects: DrawnObjects, edges: ObjectEdges) -> DrawnBoxes2D:
    """The 2D boxes of an image, and those around the strong objects in it that have none."""
    segments, rows = edges
    alone = np.setdiff1d(rows[objects.strong[rows]], drawn.objects).tolist()
    corners = [segments[rows == row].reshape(-1, 2) for row in alone]
    around = np.array([[*points.min(0), *points.max(0)] for points in corners], np.float32).reshape(-1, 4)
    colors = [class_color(class_id) for class_id in objects.boxes.class_ids[alone].tolist()]
    labels = [*drawn.labels, *(objects.labels[row] for row in alone)]
    return DrawnBoxes2D(np.concatenate([drawn.xyxy, around]), [*drawn.colors, *colors], labels)


def labels_in_the_clear(places: F64, sizes: F64, importance: F64) -> list[int]:
    """Rows of labels of which none covers another, the important ones first.

    Args:
        places: (N, 2) x and y of each label's middle.
        sizes: (N, 2) width and height.
        importance: (N,) of two that would cover each other, the more important one stays.
    """
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


def height_range(combined: CombinedCloud) -> tuple[float, float] | None:
    """Heights between which the colours of a cloud run, metres; None without points."""
    xyz = combined.cloud.xyz if len(combined.cloud) else combined.ground_cloud.xyz
    if not len(xyz):
        return None
    low, high = np.percentile(xyz[:, 2], [2, 98]).tolist()
    return low, max(high, low + 0.01)
