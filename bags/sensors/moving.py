"""What moves, put on the still view of a camera: the things themselves, their shadows, and the dark below them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from bags.sensors.lens import Lens
from bags.sensors.light import Light
from bags.sensors.still import BESIDE_PX, Still, Surfaces, contrasts, lit_surfaces, static_surfaces, turned
from bags.world.motion import Poses
from bags.world.placed import PartHits, PlacedPart
from bags.world.scene import STATIC, Scene
from pipeline.geometry import box_corners

__all__ = ["Moving", "put_movers"]

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Window = tuple[int, int, int, int]

BOX_MARGIN_M = 0.02
"""Parts may reach this far out of the box that is the truth."""
CONTACT, CONTACT_REACH = 0.62, 0.22
"""Share of the sky's light that is missing below a thing, and how far that reaches out of it, of its height."""
REACHES = 3.0
"""Contact shadows end at this many times their reach."""


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """What moving things change in a still view at one moment.

    Attributes:
        pixels: (K,) int64 the pixels that changed, rising.
        linear: (K, 3) float32 their light.
        owner: (P,) int16 row of the mover that each pixel's middle shows, or -1.
        alone_px: (M,) int64 how many pixels each mover would have if nothing stood before it.
        alone_xyxy: (M, 4) float64 left, top, right, bottom of these; NaN for none.
    """

    pixels: I64
    linear: F32
    owner: npt.NDArray[np.int16]
    alone_px: I64
    alone_xyxy: F64


class _Samples:
    """The nearest mover along N rays that all begin in the camera, found part by part."""

    def __init__(self, origin: F64, directions: F32, depth: F32) -> None:
        self.origin, self.directions, self.depth = origin, directions, depth
        self._serial = np.full(len(depth), -1, np.int32)
        self._found: list[tuple[I64, PartHits]] = []
        self._movers: list[int] = []

    def cast(self, row: int, part: PlacedPart, rows: I64) -> I64:
        """Cast some of the rays at a part of a mover; those (rows) that it would stop if nothing stood before it."""
        hits = part.cast(self.origin, self.directions.take(rows, 0))
        alone = rows.take(hits.rows)
        nearer = np.flatnonzero(hits.distance < self.depth.take(alone))
        seen = alone.take(nearer)
        self.depth[seen], self._serial[seen] = hits.distance.take(nearer), len(self._found)
        self._found.append((seen, _take(hits, nearer)))
        self._movers.append(row)
        return alone

    def nearest(self) -> tuple[I64, npt.NDArray[np.int16], Surfaces]:
        """The rays (K,) that meet a mover first, which one (K,), and what they meet there."""
        rows, kept = [np.empty(0, np.int64)], []
        for serial, (seen, hits) in enumerate(self._found):
            still_seen = np.flatnonzero(self._serial.take(seen) == serial)
            rows.append(seen.take(still_seen))
            kept.append(_take(hits, still_seen))
        all_rows = np.concatenate(rows)
        movers = np.array(self._movers, np.int16).take(self._serial.take(all_rows))
        return (
            all_rows,
            movers,
            Surfaces(
                self.origin,
                self.directions.take(all_rows, 0),
                np.concatenate([np.empty(0, np.float32), *(hits.distance for hits in kept)]),
                np.concatenate([np.empty((0, 3), np.float32), *(hits.normal for hits in kept)]),
                np.concatenate([np.empty(0, np.int64), *(hits.material for hits in kept)]),
                np.concatenate([np.empty((0, 3), np.float32), *(hits.local for hits in kept)]),
            ),
        )


class _View:
    """One mover at one moment, and the windows of a picture in which it and what it shades can be seen."""

    def __init__(
        self, scene: Scene, row: int, light: Light, lens: Lens, to_camera: Poses, lowest_m: float, time_ns: int
    ) -> None:
        mover = scene.movers[row]
        self.row, self._scene, self._lens, self._time_ns = row, scene, lens, time_ns
        self._to_camera = to_camera
        self.base = mover.path.poses(np.array([time_ns], np.int64))
        self.size, self.center = np.array(mover.size_m), np.array(mover.box_center_m)
        corners = self.base.apply(_corners(self.center, self.size + 2 * BOX_MARGIN_M))
        self.window = lens.window(self._to_camera.apply(corners))
        reach = REACHES * CONTACT_REACH * self.size[2]
        flat = _corners(self.center * (1, 1, 0), np.array([*(self.size[:2] + 2 * reach), 0.2 * self.size[2]]))
        self.contact_window = lens.window(self._to_camera.apply(self.base.apply(flat)))
        self.shadow_window: Window = (0, 0, 0, 0)
        if light.shadows:
            way = np.maximum(corners[:, 2:] - lowest_m, 0.0) / light.towards[2]
            hull = np.concatenate([corners, corners - way * light.towards])
            self.shadow_window = lens.window(self._to_camera.apply(hull))

    @cached_property
    def parts(self) -> list[PlacedPart]:
        """Its parts, where they are."""
        return self._scene.placed_parts(self.row, self._time_ns)

    @cached_property
    def part_windows(self) -> list[Window]:
        """The window of each part; empty ones, where the mover itself cannot be seen."""
        if _is_empty(self.window):
            return [(0, 0, 0, 0)] * len(self.parts)
        return [self._lens.window(self._to_camera.apply(part.corners)) for part in self.parts]

    def shades(self, points: F32, towards: F64) -> npt.NDArray[np.bool_]:
        """Whether it keeps the sun from points (N, 3)."""
        shaded = np.zeros(len(points), np.bool_)
        middle, radius = self.base.apply(self.center[None])[0], np.linalg.norm(self.size) / 2 + 2 * BOX_MARGIN_M
        offset = middle.astype(np.float32) - points
        along = offset @ towards.astype(np.float32)
        across2 = np.einsum("ij,ij->i", offset, offset) - along * along
        rows = np.flatnonzero((across2 <= radius * radius) & (along >= -radius))
        for part in self.parts if len(rows) else ():
            found = part.occludes(points.take(rows, 0), towards)
            shaded[rows[found]] = True
            rows = rows[~found]
        return shaded

    def darkness(self, points: F32) -> F32:
        """Share (N,) of the sky's light that it keeps from points near the ground below and around it."""
        rotation, translation = self.base.rotation[0].astype(np.float32), self.base.translation[0].astype(np.float32)
        local = cv2.transform((points - translation)[:, None], rotation.T.copy())[:, 0]
        outside = np.abs(local[:, :2] - self.center[:2].astype(np.float32)) - np.float32(0.46) * self.size[:2].astype(
            np.float32
        )
        np.maximum(outside, 0, out=outside)
        scale = np.float32(CONTACT_REACH * self.size[2])
        away = np.sqrt(outside[:, 0] ** 2 + outside[:, 1] ** 2) / scale
        height = np.clip(1 - np.abs(local[:, 2]) / np.float32(0.35 * self.size[2]), 0.0, 1.0)
        fading = np.clip(np.float32(REACHES) - away, 0.0, 1.0)  # nothing ends sharply where the window does
        return np.asarray(CONTACT * np.exp(-away) * height * fading, np.float32)


def put_movers(scene: Scene, light: Light, lens: Lens, still: Still, time_ns: int) -> Moving:
    """Cast what moves at one moment, in the windows where it can be seen, and its shadows."""
    to_camera, lowest_m = still.pose.inverse(), still.lowest_m
    views = [_View(scene, row, light, lens, to_camera, lowest_m, time_ns) for row in range(len(scene.movers))]
    samples = _Samples(still.pose.translation[0], still.directions, still.distance.copy())
    alone_px, alone_xyxy = np.zeros(len(views), np.int64), np.full((len(views), 4), np.nan)
    for view in views:
        alone = (
            [
                samples.cast(view.row, part, _pixels(window, lens))
                for part, window in zip(view.parts, view.part_windows, strict=True)
                if not _is_empty(window)
            ]
            if not _is_empty(view.window)
            else []
        )
        if alone:
            alone_px[view.row], alone_xyxy[view.row] = _extent(alone, lens)
    linear, owner = still.linear.copy(), np.full(len(still.linear), STATIC, np.int16)
    shadows = _shadows(light, lens, still, views)
    changed = shadows.cast
    rows = np.flatnonzero(changed)
    linear[rows] = shadows.on(still, rows)
    rows, movers, surfaces = samples.nearest()
    owner[rows] = movers
    linear[rows] = _light_of_movers(scene, light, views, surfaces)
    changed[rows] = True
    edges = _edges(lens, views, linear, owner)
    if len(edges):
        linear[edges] = _smoothed(scene, light, lens, still, views, edges, shadows.on(still, edges))
        changed[edges] = True
    pixels = np.flatnonzero(changed & lens.covered)
    return Moving(pixels, linear.take(pixels, 0), owner, alone_px, alone_xyxy)


@dataclass(frozen=True, slots=True, eq=False)
class _Shadows:
    """What movers take of the light of a still view.

    Attributes:
        cast: (P,) bool, whether they take any.
        shade: (P,) float32 share of the sun.
        dark: (P,) float32 share of all other light.
    """

    cast: npt.NDArray[np.bool_]
    shade: F32
    dark: F32

    def on(self, still: Still, pixels: I64) -> F32:
        """Light (K, 3) that is left of some pixels."""
        rest, sun = still.shading.rest.take(pixels, 0), still.shading.sun.take(pixels, 0)
        return np.asarray((1 - self.dark.take(pixels))[:, None] * rest + (1 - self.shade.take(pixels))[:, None] * sun)


def _shadows(light: Light, lens: Lens, still: Still, views: Sequence[_View]) -> _Shadows:
    """Cast the shadows of movers on a still view."""
    changed = np.zeros((lens.height, lens.width), np.bool_)
    sunny = (still.shading.sun[:, 1] > 0).reshape(changed.shape)
    shade, dark = np.zeros(changed.shape, np.float32), np.zeros(changed.shape, np.float32)
    points = still.points.reshape(*changed.shape, 3)
    touched = []
    for view in views:
        crop = _slices(view.contact_window)
        if changed[crop].size:
            share = view.darkness(points[crop].reshape(-1, 3)).reshape(changed[crop].shape)
            share *= np.isfinite(still.distance.reshape(changed.shape)[crop])
            dark[crop] = 1 - (1 - dark[crop]) * (1 - share)
            changed[crop] |= share > 0.002
        crop = _slices(view.shadow_window)
        if changed[crop].size:
            rows = np.flatnonzero(sunny[crop])
            shaded = np.zeros(changed[crop].size, np.bool_)
            shaded[rows] = view.shades(points[crop].reshape(-1, 3).take(rows, 0), light.towards)
            if shaded.any():
                shade[crop][shaded.reshape(changed[crop].shape)] = 1.0
                touched.append(view.shadow_window)
    for window in touched:
        crop = _slices(window)
        lit = sunny[crop].astype(np.float32)
        # A soft edge, as the sun is no point; only sunny neighbours count.
        soft = lit * cv2.blur(shade[crop] * lit, (3, 3)) / np.maximum(cv2.blur(lit, (3, 3)), 1e-3)
        shade[crop] = soft
        changed[crop] |= soft > 0
    return _Shadows(changed.reshape(-1), shade.reshape(-1), dark.reshape(-1))


def _light_of_movers(scene: Scene, light: Light, views: Sequence[_View], surfaces: Surfaces) -> F32:
    """Light (N, 3) from points of movers, with the shadows of everything on them."""
    shading = lit_surfaces(scene, light, surfaces)
    if light.shadows and len(surfaces.distance):
        sunny = np.flatnonzero(shading.sun[:, 1] > 0)
        points = surfaces.take(sunny).points
        for view in views:
            shaded = view.shades(points, light.towards)
            shading.sun[sunny[shaded]] = 0.0
    return np.asarray(shading.rest + shading.sun, np.float32)


def _edges(lens: Lens, views: Sequence[_View], linear: F32, owner: npt.NDArray[np.int16]) -> I64:
    """The pixels of movers, and right beside them, that differ from a neighbour."""
    found = np.zeros((lens.height, lens.width), np.bool_)
    picture, owned = linear.reshape(lens.height, lens.width, 3), owner.reshape(lens.height, lens.width) != STATIC
    for view in views:
        crop = _slices(view.window)
        if owned[crop].any():
            beside = cv2.dilate(owned[crop].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
            found[crop] |= beside & contrasts(picture[crop]).reshape(beside.shape)
    return np.flatnonzero(found.reshape(-1) & lens.covered)


def _smoothed(
    scene: Scene, light: Light, lens: Lens, still: Still, views: Sequence[_View], pixels: I64, ground: F32
) -> F32:
    """Light (E, 3) of pixels at the edges of movers: the mean of four points of each.

    Args:
        scene: The world.
        light: Light.
        lens: Of the camera.
        still: The view without movers.
        views: The movers.
        pixels: (E,) which pixels.
        ground: (E, 3) their light without movers, but with the movers' shadows.
    """
    beside = np.concatenate([lens.directions_beside(pixels, offset) for offset in BESIDE_PX])
    behind = static_surfaces(scene, still.pose, turned(still.pose, beside))
    samples = _Samples(behind.origin, behind.directions, behind.distance.copy())
    y, x = np.divmod(pixels, lens.width)
    for view in views:
        if _is_empty(view.window):
            continue
        for part, (left, top, right, bottom) in zip(view.parts, view.part_windows, strict=True):
            inside = np.flatnonzero((x >= left) & (x < right) & (y >= top) & (y < bottom))
            if len(inside):
                samples.cast(view.row, part, np.concatenate([inside + step * len(pixels) for step in range(4)]))
    colors = np.tile(ground, (4, 1))
    rows, _, surfaces = samples.nearest()
    colors[rows] = _light_of_movers(scene, light, views, surfaces)
    return np.asarray(colors.reshape(4, -1, 3).mean(0), np.float32)


def _corners(center: F64, size: F64) -> F64:
    """(8, 3) corners of an upright box."""
    return np.asarray(box_corners(center[None], size[None], np.zeros(1))[0])


def _is_empty(window: Window) -> bool:
    left, top, right, bottom = window
    return right <= left or bottom <= top


def _slices(window: Window) -> tuple[slice, slice]:
    left, top, right, bottom = window
    return slice(top, bottom), slice(left, right)


def _pixels(window: Window, lens: Lens) -> I64:
    """Numbers of the pixels in a window."""
    left, top, right, bottom = window
    return (np.arange(top, bottom)[:, None] * lens.width + np.arange(left, right)).reshape(-1)


def _extent(parts: Sequence[I64], lens: Lens) -> tuple[int, F64]:
    """How many pixels several sets hold together, and left, top, right, bottom of the rectangle around them."""
    shown = np.zeros((lens.height, lens.width), np.bool_)
    for pixels in parts:
        shown.reshape(-1)[pixels] = True
    columns, rows = np.flatnonzero(shown.any(0)), np.flatnonzero(shown.any(1))
    if not len(columns):
        return 0, np.full(4, np.nan)
    return int(shown.sum()), np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)


def _take(hits: PartHits, rows: I64) -> PartHits:
    return PartHits(*(getattr(hits, name).take(rows, 0) for name in PartHits.__slots__))
