"""Movers drawn on a still view: their bodies, their shadows, and the contact shadows below them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from lidcam.bags.simulator.sensors.lens import Lens
from lidcam.bags.simulator.sensors.light import Light
from lidcam.bags.simulator.sensors.still import BESIDE_PX, Still, contrasts, lit_surfaces
from lidcam.bags.simulator.world.motion import Poses
from lidcam.bags.simulator.world.scene import STATIC, PartHits, PlacedPart, Scene, Surfaces, mapped, passing_rays
from lidcam.pipeline.core.arrays import F32, F64, I16, I64, Bools, join_rows
from lidcam.pipeline.core.geometry.boxes import box_corners

Window = tuple[int, int, int, int]
EMPTY: Window = (0, 0, 0, 0)

BOX_MARGIN_M = 0.02  # by which parts may stick out of the ground truth box
CONTACT, CONTACT_REACH = 0.62, 0.22  # share of skylight missing below a mover; reach around it, in heights
MAX_REACHES = 3.0  # multiple of that reach where contact shadows end


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """Changes by movers in a still view at one time."""

    pixels: I64  # (K,) changed pixels, rising
    linear: F32  # (K, 3) light of these pixels
    owner: I16  # (P,) row of the mover at the middle of each pixel, or -1
    alone_px: I64  # (M,) number of pixels of each mover without occlusion
    alone_xyxy: F64  # (M, 4) left, top, right, bottom of these pixels; NaN for none


class _Samples:
    """The nearest mover along N rays from the camera, found part by part."""

    def __init__(self, origin: F64, directions: F32, depth: F32) -> None:
        self.origin, self.directions, self.depth = origin, directions, depth
        self._serial = np.full(len(depth), -1, np.int32)
        self._found: list[_Found] = []

    def cast(self, row: int, part: PlacedPart, rows: I64) -> I64:
        """Cast some of the rays at a part of a mover; returns the rows that hit it, occluded or not."""
        hits = part.cast(self.origin, self.directions.take(rows, 0))
        alone = rows.take(hits.rows)
        nearer = np.flatnonzero(hits.distance < self.depth.take(alone))
        seen = alone.take(nearer)
        self.depth[seen], self._serial[seen] = hits.distance.take(nearer), len(self._found)
        self._found.append(_Found(row, part, seen, hits, nearer))
        return alone

    def hide(self, rows: I64) -> None:
        """Mark rays that hit something static before any mover."""
        self._serial[rows] = -1

    def nearest(self) -> tuple[I64, I16, Surfaces]:
        """Rows (K,) of the rays that hit a mover first, the movers (K,), and the surfaces."""
        none, flat = np.empty((0, 3), np.float32), np.empty(0, np.float32)
        rows, movers = [np.empty(0, np.int64)], [np.empty(0, np.int16)]
        seen = [Surfaces(none, flat, none, rows[0], none, tuple(self.origin))]
        for serial, (mover, part, found, hits, nearer) in enumerate(self._found):
            left = np.flatnonzero(self._serial.take(found) == serial)
            if not len(left):
                continue
            rows.append(found.take(left))
            movers.append(np.full(len(left), mover, np.int16))
            directions = self.directions.take(rows[-1], 0)
            seen.append(part.surfaces(hits, nearer.take(left), self.origin, directions))
        return np.concatenate(rows), np.concatenate(movers), join_rows(*seen)


class _Found(NamedTuple):
    """The hits of rays on a part of a mover; `seen` (K,) are rays that had hit nothing nearer, `nearer` their rows."""

    mover: int
    part: PlacedPart
    seen: I64
    hits: PartHits
    nearer: I64


class _View:
    """One mover at one time, and the image windows that may show it or its shadows."""

    def __init__(
        self, scene: Scene, row: int, light: Light, lens: Lens, to_camera: Poses, lowest_m: float, time_ns: int
    ) -> None:
        mover = scene.movers[row]
        self.row, self._scene, self._lens, self._time_ns = row, scene, lens, time_ns
        self._to_camera = to_camera
        self.base = mover.path.poses(np.array([time_ns], np.int64))
        self.size, self.center = np.array(mover.size_m), np.array(mover.box_center_m)
        self._middle = self.base.apply(self.center[None])[0]
        self._radius = float(np.linalg.norm(self.size)) / 2 + 2 * BOX_MARGIN_M
        self.window = self.contact_window = self.shadow_window = EMPTY
        reach = MAX_REACHES * CONTACT_REACH * self.size[2]
        way = max(self._middle[2] + self._radius - lowest_m, 0.0) / light.towards[2] if light.shadows else 0.0
        around = self._to_camera.apply((self._middle - way / 2 * light.towards)[None])[0]
        if not lens.may_see(around, self._radius + 2 * reach + way / 2):
            return
        corners = self.base.apply(_corners(self.center, self.size + 2 * BOX_MARGIN_M))
        self.window = lens.window(self._to_camera.apply(corners))
        flat = _corners(self.center * (1, 1, 0), np.array([*(self.size[:2] + 2 * reach), 0.2 * self.size[2]]))
        self.contact_window = lens.window(self._to_camera.apply(self.base.apply(flat)))
        if light.shadows:
            way = np.maximum(corners[:, 2:] - lowest_m, 0.0) / light.towards[2]
            hull = np.concatenate([corners, corners - way * light.towards])
            self.shadow_window = lens.window(self._to_camera.apply(hull))

    @cached_property
    def parts(self) -> list[PlacedPart]:
        """The parts at that time."""
        return self._scene.placed_parts(self.row, self._time_ns)

    @cached_property
    def part_windows(self) -> list[Window]:
        """The window of each part."""
        return [self._lens.window(self._to_camera.apply(part.corners)) for part in self.parts]

    def shades(self, points: F32, towards: F64) -> Bools:
        """Whether it blocks the sun at points (N, 3)."""
        shaded = np.zeros(len(points), np.bool_)
        rows = passing_rays(points, towards, self._middle, self._radius)
        for part in self.parts if len(rows) else ():
            found = part.occludes(points.take(rows, 0), towards)
            shaded[rows.compress(found)] = True
            rows = rows.compress(~found)
        return shaded

    def darkness(self, points: F32) -> F32:
        """Share (N,) of skylight that it blocks at points near the ground below and around it."""
        rotation, translation = self.base.rotation[0].astype(np.float32), self.base.translation[0].astype(np.float32)
        x, y, z = mapped(points, rotation.T, -(rotation.T @ translation)).T
        beside = np.maximum(np.abs(x - np.float32(self.center[0])) - np.float32(0.46 * self.size[0]), 0)
        ahead = np.maximum(np.abs(y - np.float32(self.center[1])) - np.float32(0.46 * self.size[1]), 0)
        away = np.sqrt(beside * beside + ahead * ahead) * np.float32(1 / (CONTACT_REACH * self.size[2]))
        height = np.clip(1 - np.abs(z) * np.float32(1 / (0.35 * self.size[2])), 0.0, 1.0)
        fading = np.clip(np.float32(MAX_REACHES) - away, 0.0, 1.0)  # fade out before the end of the window
        return np.asarray(CONTACT * np.exp(-away) * height * fading, np.float32)


def put_movers(scene: Scene, light: Light, lens: Lens, still: Still, time_ns: int) -> Moving:
    """Render movers and their shadows at one time, in the windows that may show them."""
    to_camera, lowest_m = still.pose.inverse(), still.lowest_m
    views = [_View(scene, row, light, lens, to_camera, lowest_m, time_ns) for row in range(len(scene.movers))]
    alone_px, alone_xyxy = np.zeros(len(views), np.int64), np.full((len(views), 4), np.nan)
    owner = np.full(len(still.linear), STATIC, np.int16)
    windows = [window for view in views for window in (view.window, view.contact_window, view.shadow_window)]
    if all(map(_is_empty, windows)):
        return Moving(np.empty(0, np.int64), np.empty((0, 3), np.float32), owner, alone_px, alone_xyxy)
    linear = still.linear.copy()
    samples = _Samples(still.pose.translation[0], still.directions, still.distance.copy())
    for view in views:
        if _is_empty(view.window):
            continue
        alone = [
            samples.cast(view.row, part, lens.hull(to_camera.apply(part.corners), window))
            for part, window in zip(view.parts, view.part_windows, strict=True)
            if not _is_empty(window)
        ]
        if alone:
            alone_px[view.row], alone_xyxy[view.row] = _extent(alone, lens)
    shadows = _shadows(light, lens, still, views)
    changed = shadows.cast
    rows = np.flatnonzero(changed)
    linear[rows] = shadows.on(still, rows)
    rows, movers, surfaces = samples.nearest()
    owner[rows] = movers
    linear[rows] = _light_of_movers(scene, light, views, surfaces)
    changed[rows] = True
    edges = _edges(lens, views, linear, owner) if len(rows) else rows
    if len(edges):
        linear[edges] = _smoothed(scene, light, lens, still, views, edges, shadows.on(still, edges))
        changed[edges] = True
    pixels = np.flatnonzero(changed & lens.covered)
    return Moving(pixels, linear.take(pixels, 0), owner, alone_px, alone_xyxy)


@dataclass(frozen=True, slots=True, eq=False)
class _Shadows:
    """Light that movers take from a still view."""

    cast: Bools  # (P,) bool, whether they take any
    shade: F32  # (P,) float32 share of sunlight taken
    dark: F32  # (P,) float32 share of all other light taken

    def on(self, still: Still, pixels: I64) -> F32:
        """Remaining light (K, 3) of some pixels."""
        left, sunny = 1 - self.dark.take(pixels)[:, None], 1 - self.shade.take(pixels)[:, None]
        return still.shading.rest.take(pixels, 0) * left + still.shading.sun.take(pixels, 0) * sunny


def _shadows(light: Light, lens: Lens, still: Still, views: Sequence[_View]) -> _Shadows:
    changed = np.zeros((lens.height, lens.width), np.bool_)
    sunlight = still.shading.sun.reshape(*changed.shape, 3)[..., 1]
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
            rows = np.flatnonzero(sunlight[crop] > 0)
            shaded = np.zeros(changed[crop].size, np.bool_)
            shaded[rows] = view.shades(points[crop].reshape(-1, 3).take(rows, 0), light.towards)
            if shaded.any():
                shade[crop][shaded.reshape(changed[crop].shape)] = 1.0
                touched.append(view.shadow_window)
    for window in touched:
        crop = _slices(window)
        lit = (sunlight[crop] > 0).astype(np.float32)
        # A soft edge, as the sun is not a point; only sunny neighbours count.
        soft = lit * cv2.blur(shade[crop] * lit, (3, 3)) / np.maximum(cv2.blur(lit, (3, 3)), 1e-3)
        shade[crop] = soft
        changed[crop] |= soft > 0
    return _Shadows(changed.reshape(-1), shade.reshape(-1), dark.reshape(-1))


def _light_of_movers(scene: Scene, light: Light, views: Sequence[_View], surfaces: Surfaces) -> F32:
    """Light (N, 3) from surfaces of movers, with all shadows."""
    shading = lit_surfaces(scene, light, surfaces)
    if light.shadows and len(surfaces.distance):
        sunny = np.flatnonzero(shading.sun[:, 1] > 0)
        points = surfaces.select(sunny).points
        for view in views:
            shaded = view.shades(points, light.towards)
            shading.sun[sunny[shaded]] = 0.0
    return np.asarray(shading.rest + shading.sun, np.float32)


def _edges(lens: Lens, views: Sequence[_View], linear: F32, owner: I16) -> I64:
    """Pixels on movers or next to them that differ from a neighbour."""
    found = np.zeros((lens.height, lens.width), np.bool_)
    image, owned = linear.reshape(lens.height, lens.width, 3), owner.reshape(lens.height, lens.width) != STATIC
    for view in views:
        crop = _slices(view.window)
        if owned[crop].any():
            beside = cv2.dilate(owned[crop].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
            found[crop] |= beside & contrasts(image[crop]).reshape(beside.shape)
    return np.flatnonzero(found.reshape(-1) & lens.covered)


def _smoothed(
    scene: Scene, light: Light, lens: Lens, still: Still, views: Sequence[_View], pixels: I64, ground: F32
) -> F32:
    """Light (E, 3) of pixels (E,) at the edges of movers, as the mean of four samples.

    `ground` (E, 3) is their light without movers, but with the movers' shadows.
    """
    beside = np.concatenate([lens.directions_beside(pixels, offset) for offset in BESIDE_PX])
    origin, directions = still.pose.translation[0], mapped(beside, still.pose.rotation[0])
    samples = _Samples(origin, directions, np.full(len(directions), np.inf, np.float32))
    y, x = np.divmod(pixels, lens.width)
    for view in views:
        if _is_empty(view.window):
            continue
        for part, (left, top, right, bottom) in zip(view.parts, view.part_windows, strict=True):
            inside = np.flatnonzero((x >= left) & (x < right) & (y >= top) & (y < bottom))
            if len(inside):
                samples.cast(view.row, part, np.concatenate([inside + step * len(pixels) for step in range(4)]))
    # A static surface can be in front of a mover only if it is that near at a neighbouring pixel, too.
    doubtful = np.flatnonzero(np.isfinite(samples.depth) & (samples.depth >= np.tile(still.nearest.take(pixels), 4)))
    behind = scene.static.answer(origin, directions.take(doubtful, 0))["t_hit"].numpy()
    samples.hide(doubtful.compress(behind <= samples.depth.take(doubtful)))
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


def _extent(parts: Sequence[I64], lens: Lens) -> tuple[int, F64]:
    """Number of pixels in the union of several sets, and left, top, right, bottom of their bounding box.

    Pixels that the lens does not cover show nothing.
    """
    shown = np.zeros((lens.height, lens.width), np.uint8)
    for pixels in parts:
        shown.reshape(-1)[pixels.compress(lens.covered.take(pixels))] = 1
    left, top, width, height = cv2.boundingRect(shown)
    box = (left, top, left + width, top + height) if width else np.full(4, np.nan)
    return cv2.countNonZero(shown), np.array(box, np.float64)
