"""Camera lenses: viewing directions of pixels, and image regions of 3D points."""

from functools import cached_property

import cv2
import numpy as np

from lidcam.bags.simulator.scenario.sensors import CameraScenario
from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.camera import NEAR_M, CameraModel
from lidcam.pipeline.core.optics.lenses import Lenses

MIN_PRUNED_PX = 1000  # windows with fewer pixels are not worth pruning
MAX_FILLED_PX = 10_000  # coordinates within which OpenCV can fill shapes


def camera_model(scenario: CameraScenario) -> CameraModel:
    """The true intrinsics of a camera."""
    fx, fy = scenario.focal_px
    # As in CameraInfo, whole pixel coordinates are pixel centres, so the middle is at (n - 1) / 2.
    cx, cy = scenario.center_px or ((scenario.width_px - 1) / 2, (scenario.height_px - 1) / 2)
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    size, coefficients = (scenario.width_px, scenario.height_px), np.array(scenario.coefficients, np.float64)
    return CameraModel(scenario.frame_id, *size, K, scenario.distortion_model, coefficients)


class Lens:
    """The inverse of `CameraModel.project` for every pixel, computed once.

    Pixels are numbered row by row: pixel p is in row p // width and column p % width. `covered` (P,) says whether the
    lens covers each.
    """

    def __init__(self, model: CameraModel) -> None:
        self.model = model
        self.width, self.height = model.width_px, model.height_px
        self._bent = not model.is_straight or model.K[0, 1] != 0
        rows, columns = np.divmod(np.arange(self.width * self.height), self.width)
        rays, covered = Lenses.of([model]).rays_of_pixels(np.stack([columns + 0.5, rows + 0.5], -1)[None])
        self._plane, self.covered = rays[0, :, :2], covered[0]

    @cached_property
    def directions(self) -> F32:
        """(P, 3) unit vectors through the pixel centres, in the optical frame."""
        return _through(self._plane)

    def directions_beside(self, pixels: I64, offset_px: tuple[float, float]) -> F32:
        """(K, 3) unit vectors through points at an offset from the centres of pixels (K,).

        Within a pixel the lens is taken as linear, which is right to some thousandths of a pixel.
        """
        if not self._bent:
            return _through(self._plane.take(pixels, 0) + np.array(offset_px) / self.model.K[[0, 1], [0, 1]])
        across, down = (slope.take(pixels, 0) for slope in self._slopes)
        return _through(self._plane.take(pixels, 0) + offset_px[0] * across + offset_px[1] * down)

    @cached_property
    def _seen_radius(self) -> float:
        """Upper limit of the distance from the axis that any pixel sees, in the plane z = 1."""
        return 1.02 * float(np.hypot(self._plane[:, 0], self._plane[:, 1]).max(initial=0.0)) + 0.01

    def may_see(self, center: F64, radius: float) -> bool:
        """Whether any pixel may show part of a sphere in the optical frame; conservative."""
        x, y, z = center.tolist()
        half = np.arctan(self._seen_radius)  # half angle of the cone around all pixels
        return bool(np.hypot(x, y) * np.cos(half) - z * np.sin(half) <= radius)

    @cached_property
    def _slopes(self) -> tuple[F32, F32]:
        """Change of x, y in the plane z = 1 (P, 2) per pixel to the right, and per pixel down."""
        plane = self._plane.reshape(self.height, self.width, 2)
        both = []
        for axis, focal, part in ((1, self.model.K[0, 0], 0), (0, self.model.K[1, 1], 1)):
            slope = np.zeros_like(plane) if plane.shape[axis] < 2 else np.gradient(plane, axis=axis)
            usual = np.zeros(2)
            usual[part] = 1 / focal
            # Differences are not usable next to pixels that the lens does not cover.
            doubtful = ~np.isfinite(slope).all(-1, keepdims=True) | (np.abs(slope - usual).max(-1) > 1)[..., None]
            both.append(np.where(doubtful | (plane.shape[axis] < 2), usual, slope).reshape(-1, 2).astype(np.float32))
        return both[0], both[1]

    def hull(self, points: F64, window: tuple[int, int, int, int]) -> I64:
        """Pixels (K,) of a window, rising, that may show the convex hull of points (N, 3) in the optical frame."""
        left, top, right, bottom = window
        width = right - left
        whole = self._bent or width * (bottom - top) < MIN_PRUNED_PX or (points[:, 2] < NEAR_M).any()
        pixels = None if whole else self.model.project(points)[0] - 0.5
        if pixels is None or np.abs(pixels).max() > MAX_FILLED_PX:
            return (np.arange(top, bottom)[:, None] * self.width + np.arange(left, right)).reshape(-1)
        inside = np.zeros((bottom - top, width), np.uint8)
        corners = np.rint((pixels - (left, top)) * 16).astype(np.int32)
        cv2.fillConvexPoly(inside, cv2.convexHull(corners), 1, shift=4)
        rows = np.flatnonzero(cv2.dilate(inside, np.ones((3, 3), np.uint8)))
        return rows + rows // width * (self.width - width) + (top * self.width + left)

    def window(self, points: F64) -> tuple[int, int, int, int]:
        """Left, top, right, bottom of the window that holds the convex hull of points (K, 3) in the optical frame.

        As for slices; empty if right <= left or bottom <= top.
        """
        ahead = points[:, 2] >= NEAR_M
        if not ahead.any():
            return 0, 0, 0, 0
        samples = points if ahead.all() and not self._bent else _hull_samples(points)
        pixels = self.model.project(samples)[0]
        if self._bent:  # outside the view the lens model need not hold: only the direction matters
            plane = samples[:, :2] / samples[:, 2:]
            radius = np.hypot(plane[:, 0], plane[:, 1])
            aside = radius > self._seen_radius
            outwards = 4 * max(self.width, self.height) * plane[aside] / radius[aside, None]
            unbent = 1.5 * self.model.K[[0, 1], [0, 1]] * plane[aside]
            pixels = np.concatenate([pixels[~aside], self.model.K[:2, 2] + outwards, self.model.K[:2, 2] + unbent])
        low, high = np.floor(pixels.min(0)) - 2, np.ceil(pixels.max(0)) + 2
        left, top = np.clip(low, 0, [self.width, self.height]).astype(int)
        right, bottom = np.clip(high, 0, [self.width, self.height]).astype(int)
        return int(left), int(top), int(right), int(bottom)


def _through(plane: F64) -> F32:
    """Unit vectors (N, 3) through points (N, 2) of the plane z = 1."""
    x, y = plane[:, 0], plane[:, 1]
    share = 1 / np.sqrt(x * x + y * y + 1)
    return np.stack([x * share, y * share, share], 1).astype(np.float32)


def _hull_samples(points: F64) -> F64:
    """Samples on the lines between all pairs of points (K, 3), clipped at the near plane."""
    first, second = np.triu_indices(len(points), 1)
    start, end = points[first], points[second]
    shown = np.maximum(start[:, 2], end[:, 2]) >= NEAR_M
    start, end = start[shown], end[shown]
    rise = np.where(start[:, 2:] == end[:, 2:], 1.0, end[:, 2:] - start[:, 2:])
    cut = start + np.clip((NEAR_M - start[:, 2:]) / rise, 0.0, 1.0) * (end - start)
    start, end = np.where(start[:, 2:] < NEAR_M, cut, start), np.where(end[:, 2:] < NEAR_M, cut, end)
    share = np.linspace(0.0, 1.0, 5)[:, None, None]
    return np.asarray((start * (1 - share) + end * share).reshape(-1, 3))
