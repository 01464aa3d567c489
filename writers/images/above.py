"""The site from above: points, zones, sensors, and the objects with their trails."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, U8, Array
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.rig import Rig
from lidcam.writers.drawing import DrawnObjects, ground_ellipses, strong_objects
from lidcam.writers.images.canvas import FAINT_TEXT, TEXT, Canvas, Color, Label
from lidcam.writers.palette import GROUND, HEIGHT_COLORS, class_color, height_rows
from lidcam.writers.viewpoint import front_of_rig, zone_texts

_GRID: Color = (38, 42, 48)
_ZONE: Color = (126, 138, 170)
_SENSOR: Color = (225, 228, 235)
_OPACITY = 0.35
_GRID_PX, _LETTER_PX, _WEDGE_PX = 110, 15, 22

_SURROUNDED = 0.2
"""Sensors farther apart than this share of the distance of most points stand around the scene, as in `SceneSurvey`."""

_POINTS_PERCENT, _OBJECTS_PERCENT = [2, 98], [10, 90]
"""Between these the points and the objects of a frame are in view, along each axis."""

_MARGIN, _LEAST_M = 1.1, 0.5


class Area(NamedTuple):
    """The part of the site that is shown."""

    middle: F64  # (2,) metres, in the site frame
    axes: F64  # (2, 2) unit vectors in the site frame: to the right and ahead
    half_m: F64  # (2,) half its extent along them
    is_site: bool  # Whether sensors stand around it: then x is to the right, as on a map


def area_of(result: FrameResult, rig: Rig) -> Area | None:
    """The area that suits what a frame shows; None where there are neither points nor objects."""
    boxes = result.fused.objects.select(strong_objects(result))
    objects = box_corners(boxes.centers, boxes.sizes, boxes.yaws)[..., :2].reshape(-1, 2)
    points = np.concatenate([result.combined.cloud.xyz, result.combined.ground_cloud.xyz])[:, :2].astype(np.float64)
    if not len(points) and not len(objects):
        return None
    poses = [lidar.T_site_lidar for lidar in rig.lidars] + [camera.T_camera_site.inverse() for camera in rig.cameras]
    sensors = np.array([pose.translation[:2] for pose in poses]).reshape(-1, 2)
    center = sensors.mean(0) if len(sensors) else np.zeros(2)
    reach_m = np.percentile(np.linalg.norm(np.concatenate([points, objects]) - center, axis=1), 90)
    is_site = bool((np.linalg.norm(sensors - center, axis=1) >= _SURROUNDED * reach_m).any())
    x, y = (0.0, 1.0) if is_site else front_of_rig(rig).tolist()
    axes = np.array([[y, -x], [x, y]])
    shown = [sensors @ axes.T]
    for places, percent in ((points, _POINTS_PERCENT), (objects, _OBJECTS_PERCENT)):
        shown += [np.percentile(places @ axes.T, percent, axis=0)] if len(places) else []
    low, high = np.concatenate(shown).min(0), np.concatenate(shown).max(0)
    return Area((low + high) / 2 @ axes, axes, np.maximum(_MARGIN * (high - low) / 2, _LEAST_M), is_site)


class SiteMap:
    """Where places of the site lie in an image.

    Attributes:
        px_per_m: Its scale.
    """

    def __init__(self, area: Area, width_px: int, height_px: int) -> None:
        self._middle, self._middle_px = area.middle, np.array([width_px / 2, height_px / 2])
        upright, lying = ((self._middle_px / half_m).min() for half_m in (area.half_m, area.half_m[::-1]))
        is_lying = not area.is_site and lying > upright  # the front of a vehicle is to the right
        self.px_per_m = float(lying if is_lying else upright)
        self._axes = area.axes[::-1] if is_lying else area.axes * [[1.0], [-1.0]]

    def pixels(self, places: Array) -> F64:
        """(..., 2) pixels of places (..., 2 or more) in metres."""
        return np.asarray((places[..., :2] - self._middle) @ self._axes.T * self.px_per_m + self._middle_px)

    def bounds_m(self) -> F64:
        """(2, 2) lowest and highest x, y in view."""
        corners = self._middle_px * [[-1, -1], [1, -1], [1, 1], [-1, 1]] / self.px_per_m @ self._axes
        return np.stack([corners.min(0), corners.max(0)]) + self._middle


def draw_above(
    drawn: DrawnObjects,
    rig: Rig,
    trails: Sequence[F64],
    *,
    area: Area,
    heights: tuple[float, float],
    size_px: tuple[int, int],
) -> U8:
    """The frame from above, (H, W, 3), red, green, blue.

    `trails` (K, 3) are those of each object in the site frame; the colours of points run between two heights in metres.
    """
    canvas, site = Canvas.blank(*size_px, _LETTER_PX), SiteMap(area, *size_px)
    _draw_grid(canvas, site)
    ground, cloud = drawn.result.combined.ground_cloud, drawn.result.combined.cloud
    _draw_points(canvas, site, ground, np.broadcast_to(np.array(GROUND, np.uint8), (len(ground), 3)))
    _draw_points(canvas, site, cloud, HEIGHT_COLORS[height_rows(cloud.xyz[:, 2], heights)])
    labels = _draw_zones(canvas, site, drawn, rig)
    canvas.dots([site.pixels(lidar.T_site_lidar.translation) for lidar in rig.lidars], _SENSOR, 3.5)
    for view in drawn.result.views.values():
        aside = view.model.width_px / 2 / view.model.K[0, 0]
        wedge = np.array([[-aside, 0, 1], [0, 0, 0], [aside, 0, 1]]) * _WEDGE_PX / site.px_per_m
        canvas.lines([site.pixels(np.asarray(view.T_camera_site.inverse().apply(wedge)))], _SENSOR)
    canvas.labels(labels + _draw_objects(canvas, site, drawn, trails))
    return canvas.pixels


def _draw_grid(canvas: Canvas, site: SiteMap) -> None:
    """Lines of round numbers of metres, and how far they are apart."""
    least = _GRID_PX / site.px_per_m
    power = 10.0 ** np.floor(np.log10(least))
    step = next(float(factor * power) for factor in (1, 2, 5, 10) if factor * power >= least)
    low, high = site.bounds_m()
    across, along = (np.arange(np.ceil(low[axis] / step), high[axis] / step) * step for axis in (0, 1))
    lines = [np.array([[x, low[1]], [x, high[1]]]) for x in across]
    lines += [np.array([[low[0], y], [high[0], y]]) for y in along]
    canvas.lines([site.pixels(line) for line in lines], _GRID)
    right, bottom = canvas.size_px[0] - 16, canvas.size_px[1] - 14
    left = right - step * site.px_per_m
    bar = np.array([[left, bottom - 5], [left, bottom], [right, bottom], [right, bottom - 5]])
    canvas.lines([bar], TEXT)
    canvas.text((left + right) / 2, bottom - 2, f"{step:g} m", FAINT_TEXT, share=0.5)


def _draw_points(canvas: Canvas, site: SiteMap, cloud: PointCloud, colors: U8) -> None:
    """Points, 2 x 2 pixels each."""
    places = np.floor(site.pixels(cloud.xyz)).astype(np.intp)
    inside = ((places >= 0) & (places < np.array(canvas.size_px) - 1)).all(1)
    columns, rows, colors = places[inside, 0], places[inside, 1], colors[inside]
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        canvas.pixels[rows + down, columns + right] = colors


def _draw_zones(canvas: Canvas, site: SiteMap, drawn: DrawnObjects, rig: Rig) -> list[Label]:
    """The zones as far as they are in view; returns their names with the number of objects in each."""
    low, high = site.bounds_m()
    labels = []
    for zone, text in zip(rig.zones, zone_texts(rig, drawn.boxes.centers[drawn.strong]), strict=True):
        canvas.lines([site.pixels(np.clip(zone.polygon_site, 2 * low - high, 2 * high - low))], _ZONE, closed=True)
        x, y = site.pixels(np.clip(zone.polygon_site, low, high).mean(0)).tolist()
        labels.append(Label(x, y, text, _ZONE, 0.0))
    return labels


def _draw_objects(canvas: Canvas, site: SiteMap, drawn: DrawnObjects, trails: Sequence[F64]) -> list[Label]:
    """The objects, the strong ones on top; returns their labels."""
    objects, strong, thin = drawn.boxes, drawn.strong, drawn.thin
    colors = [tuple(color) for color in np.round(drawn.colors * 255).astype(int).tolist()]
    outlines = site.pixels(box_corners(objects.centers, objects.sizes, objects.yaws)[:, :4])
    headings, lengths = np.stack([np.cos(objects.yaws), np.sin(objects.yaws)], 1), drawn.arrow_lengths_m
    middles, tips = site.pixels(objects.centers), site.pixels(objects.centers[:, :2] + headings * lengths[:, None])
    ellipses, labels = site.pixels(ground_ellipses(objects)), []
    filled = np.flatnonzero(strong & ~thin).tolist()
    canvas.areas([outlines[row] for row in filled], [colors[row] for row in filled], _OPACITY)
    for row in np.argsort(strong, kind="stable").tolist():
        canvas.lines([site.pixels(trails[row])] if len(trails[row]) else [], colors[row])
        canvas.lines([outlines[row]], colors[row], 2 if row in filled else 1, closed=True)
        if row in filled and lengths[row] > 0:
            canvas.arrow(middles[row], tips[row], colors[row])
        if strong[row] and thin[row]:
            canvas.lines([ellipses[row]], colors[row], closed=True)
        if strong[row] and (outlines[row] > 0).all() and (outlines[row] < canvas.size_px).all():
            (left, top), color = outlines[row].min(0).tolist(), class_color(int(objects.class_ids[row])).bytes_rgb
            labels.append(Label(left, top - 3, drawn.labels[row], color, 1.0 + float(objects.scores[row])))
    return labels
