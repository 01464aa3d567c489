"""Images of a run: its cameras side by side, the site from above, and a clock."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from math import ceil
from statistics import median
from typing import Literal, NamedTuple

import cv2
import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, U8
from lidcam.pipeline.core.errors import ConfigError, MessageError
from lidcam.pipeline.core.frame import FrameResult, Missing
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.text import brief
from lidcam.writers.drawing import DrawnObjects, camera_image, drawn_boxes_2d, height_range, object_edges
from lidcam.writers.images.above import Area, SiteMap, area_of, draw_above
from lidcam.writers.images.canvas import FAINT_TEXT, TEXT, Canvas, Label
from lidcam.writers.palette import MATCHED, class_color
from lidcam.writers.trails import Trails
from lidcam.writers.viewpoint import cameras_in_order

Look = Literal["full", "compact"]
"""`compact`: thin lines and short texts, without the lines between what belongs together."""


def draw_camera(
    drawn: DrawnObjects, camera: CameraSensor, image: U8 | None, *, width_px: int, title: str, look: Look
) -> U8:
    """The image of a camera in a frame, (H, W, 3), red, green, blue, with a title in the corner.

    `image` (H, W, 3) is what the camera saw; None where there is none.
    """
    scale, is_full = width_px / camera.model.width_px, look == "full"
    canvas = _canvas(image, width_px, round(camera.model.height_px * scale))
    result, objects, strong, thin = drawn.result, drawn.boxes, drawn.strong, drawn.thin
    pieces, rows = object_edges(result, [camera.name])[camera.name]
    edges = [pieces[rows == row] * np.float32(scale) for row in range(len(objects))]
    colors = np.round(drawn.colors * 255).astype(int).tolist()
    depths = np.asarray(result.views[camera.name].T_camera_site.apply(objects.centers))[:, 2]
    for row in np.argsort(-depths, kind="stable").tolist():
        is_wide = is_full and strong[row]
        canvas.lines(edges[row], colors[row], 2 if is_wide and not thin[row] else 1, shade=is_wide)
    boxes = drawn_boxes_2d(drawn, camera.name)
    labels = []
    for box, color, text, row, overlap in zip(boxes.xyxy * scale, *boxes[1:], strict=True):
        left, top, right, bottom = (np.floor(box) + 0.5).tolist()  # sharp lines
        corners = [[left, top], [right, top], [right, bottom], [left, bottom]]
        canvas.lines([corners], color.bytes_rgb, closed=True, shade=is_full)
        if is_full and color is MATCHED:
            text = f"{text}, IoU {overlap:.2f}"
            ends = [(box[:2] + box[2:]) / 2, *(_around(edges[row]).reshape(-1, 2, 2).mean(1))]
            canvas.lines([ends], MATCHED.bytes_rgb, shade=1)
            canvas.dots(ends, MATCHED.bytes_rgb, 2.5)
        labels.append(Label(left, top - 2, text, color.bytes_rgb, 2.0 + (color is MATCHED)))
    class_ids = objects.class_ids.tolist()
    for row in np.flatnonzero(strong).tolist():
        for left, top, *_ in _around(edges[row]).tolist() if row not in boxes.objects else ():
            labels.append(Label(left, top - 2, drawn.labels[row], class_color(class_ids[row]).bytes_rgb, 1.0))
    if not is_full:  # without speeds
        labels = [label._replace(text=label.text.partition(", ")[0]) for label in labels]
    canvas.labels([Label(0.0, 0.0, title, TEXT, np.inf), *labels])
    return canvas.pixels


def _canvas(image: U8 | None, width_px: int, height_px: int) -> Canvas:
    letter_px = min(max(round(height_px / 45), 14), 40)
    if image is None:
        canvas = Canvas.blank(width_px, height_px, letter_px)
        canvas.text(width_px / 2, height_px / 2, "no image", share=0.5)
        return canvas
    way = cv2.INTER_AREA if image.shape[1] > width_px else cv2.INTER_LINEAR
    return Canvas(np.array(cv2.resize(image, (width_px, height_px), interpolation=way)), letter_px)


def _around(pieces: F32) -> F64:
    """(1, 4) left, top, right, bottom of lines (M, 2, 2); (0, 4) without any."""
    points = pieces.reshape(-1, 2).astype(np.float64)
    return np.concatenate([points.min(0), points.max(0)])[None] if len(points) else np.zeros((0, 4))


SIZE_PX = (1920, 1080)
"""Width and height of an image of all cameras, pixels."""

BAR_PX, GAP_PX = 40, 4
MAX_IMAGES_SHARE = 0.6
FULL_PX = 900
"""Images of this width have room for long texts."""

_MIN_CLOCK_NS = 10**18
"""Stamps before 2001 count from the start of a simulation: they are no dates."""

_UNKNOWN_AREA = Area(np.zeros(2), np.eye(2), np.full(2, 10.0), is_site=True)

Drawn = tuple[U8, tuple[Drop, ...]]
"""An image, (H, W, 3) red, green, blue, and the images of the frame that cannot be decoded, dark in it."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The content of the images of a frame."""

    frame: FrameResult  # The frame
    trails: list[F64]  # Of each of its objects (K, 3)
    # By camera, the frame whose image is shown: an earlier one where the camera is slow; those without are left out
    images: Mapping[str, FrameResult]

    __repr__ = brief


class Scenes:
    """Draws the frames of a run, and gathers what images need of earlier ones; `decode` may raise MessageError."""

    def __init__(self, rig: Rig, config: Config, decode: Callable[[RawMessage], Image]) -> None:
        self._rig, self._names, self._decode = rig, config.object_names, decode
        self._trails = Trails(rig.site_frame, config.combine.motion)
        self._images: dict[str, FrameResult] = {}
        self._start_ns: int | None = None
        self._area: Area | None = None
        self._heights: tuple[float, float] | None = None

    def add_frame(self, result: FrameResult) -> Scene:
        """Take the next frame in."""
        self._start_ns = result.bundle.stamp_ns if self._start_ns is None else self._start_ns
        self._area = self._area or area_of(result, self._rig)
        self._heights = self._heights or height_range(result.combined)
        for camera in self._rig.cameras:
            if camera_image(result, camera) is not None or camera.name in result.detections.cameras:
                self._images[camera.name] = result
            elif result.bundle.missing.get(camera.topic or camera.boxes_topic) != Missing.NOT_NEAR:
                self._images.pop(camera.name, None)  # silent, or its image is unfit
        return Scene(result, self._trails.add_frame(result), dict(self._images))

    def camera(self, scene: Scene, name: str) -> Drawn:
        """The image of a camera in its own size.

        Raises:
            ConfigError: there is no camera of that name.
        """
        cameras = {camera.name: camera for camera in self._rig.cameras}
        if name not in cameras:
            raise ConfigError(f"camera: expected one of {', '.join(cameras) or 'no camera'}, found {name!r}")
        return self._camera(scene, cameras[name], cameras[name].model.width_px, "full")

    def all_cameras(self, scene: Scene) -> Drawn:
        """The image of all cameras and of the site from above."""
        cameras, area = cameras_in_order(self._rig), self._area or _UNKNOWN_AREA
        places, above = _arranged([one.model.width_px / one.model.height_px for one in cameras], area)
        canvas = Canvas.blank(*SIZE_PX, letter_px=20)
        drops: list[Drop] = []
        for place, camera in zip(places, cameras, strict=True):
            width_px = min(place.width, int(place.height * camera.model.width_px / camera.model.height_px))
            image, unfit = self._camera(scene, camera, width_px, "full" if width_px >= FULL_PX else "compact")
            _paste(canvas, image, place)
            drops += unfit
        drawn, heights, size_px = DrawnObjects.of(scene.frame, self._names), self._heights or (0.0, 1.0), above[2:]
        site = draw_above(drawn, self._rig, scene.trails, area=area, heights=heights, size_px=size_px)
        _paste(canvas, site, above)
        self._draw_bar(canvas, drawn)
        return canvas.pixels, tuple(drops)

    def _camera(self, scene: Scene, camera: CameraSensor, width_px: int, look: Look) -> Drawn:
        shown, image, drops = scene.images.get(camera.name, scene.frame), None, []
        late_s = (scene.frame.bundle.stamp_ns - shown.bundle.stamp_ns) / 1e9
        if (message := camera_image(shown, camera)) is not None:
            try:
                image = self._decode(message).rgb
            except MessageError as err:
                drops = [Drop(message.topic, message.stamp_ns, "the image cannot be shown", str(err))]
        title = f"{camera.name}, {late_s:.1f} s ago" if late_s else camera.name
        drawn = DrawnObjects.of(shown, self._names)
        pixels = draw_camera(drawn, camera, image, width_px=width_px, title=title, look=look)
        return pixels, () if late_s else tuple(drops)

    def _draw_bar(self, canvas: Canvas, drawn: DrawnObjects) -> None:
        """The clock, and how many objects of each class there are."""
        bundle = drawn.result.bundle
        stamp_ns = bundle.stamp_ns
        clock = f"{(stamp_ns - (self._start_ns or 0)) / 1e9:.1f} s"
        if stamp_ns >= _MIN_CLOCK_NS:
            time = datetime.fromtimestamp(stamp_ns // 10**9, UTC)
            clock = f"{time:%Y-%m-%d %H:%M:%S}.{stamp_ns // 10**8 % 10} UTC   {clock}"
        ids, counts = np.unique(drawn.boxes.class_ids[drawn.strong], return_counts=True)
        found = [f"{self._names[row]} {count}" for row, count in zip(ids.tolist(), counts.tolist(), strict=True)]
        canvas.text(12, BAR_PX - 8, clock)
        text = f"{', '.join(found) or 'no objects'}   frame {bundle.index}"
        canvas.text(SIZE_PX[0] - 12, BAR_PX - 8, text, FAINT_TEXT, share=1.0)


class _Place(NamedTuple):
    """A part of the image, pixels."""

    left: int
    top: int
    width: int
    height: int


def _arranged(aspects: list[float], area: Area) -> tuple[list[_Place], _Place]:
    """Where the images lie, by their aspects, and where the site from above does.

    Of all grids, above or to the right, the one in which images and area are both large, and little is left empty.
    """
    width, height = SIZE_PX[0], SIZE_PX[1] - BAR_PX
    if not aspects:
        return [], _Place(0, BAR_PX, width, height)
    count, aspect = len(aspects), median(aspects)
    found: list[tuple[float, list[_Place], _Place]] = []
    for columns in range(1, count + 1):
        rows = ceil(count / columns)
        for right, down in ((MAX_IMAGES_SHARE, 1.0), (1.0, MAX_IMAGES_SHARE)):
            tile_width = int(min(right * width / columns, down * height / rows * aspect))
            tile_height = int(tile_width / aspect)
            size_px = tile_width - GAP_PX, tile_height - GAP_PX
            if right < 1:
                left = width - columns * tile_width
                above = _Place(0, BAR_PX, left - GAP_PX, height)
            else:
                left, top = (width - columns * tile_width) // 2, rows * tile_height + GAP_PX
                above = _Place(0, BAR_PX + top, width, height - top)
            tiles = [
                _Place(left + column * tile_width, BAR_PX + row * tile_height, *size_px)
                for row, column in (divmod(number, columns) for number in range(count))
            ]
            filled = (count * tile_width * tile_height + above.width * above.height) / (width * height)
            scale = SiteMap(area, above.width, above.height).px_per_m
            found.append((tile_width * tile_height * scale * filled**2, tiles, above))
    return max(found, key=lambda one: one[0])[1:]


def _paste(canvas: Canvas, image: U8, place: _Place) -> None:
    """Put an image into the middle of its place, which is at least as large."""
    height, width = image.shape[:2]
    top, left = place.top + (place.height - height) // 2, place.left + (place.width - width) // 2
    canvas.pixels[top : top + height, left : left + width] = image
