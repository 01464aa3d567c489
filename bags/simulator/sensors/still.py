"""A camera's view of the static world, kept so that movers and shadows can be drawn on it."""

from dataclasses import dataclass

import cv2
import numpy as np

from lidcam.bags.simulator.sensors.lens import Lens
from lidcam.bags.simulator.sensors.light import Light, Shading
from lidcam.bags.simulator.world.motion import Poses
from lidcam.bags.simulator.world.scene import Scene, Surfaces, mapped
from lidcam.bags.simulator.world.textures import surface_rgb
from lidcam.pipeline.core.arrays import F32, Bools

BESIDE_PX = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
"""The four sample points of a pixel that differs from its neighbours (anti-aliasing)."""
MIN_CONTRAST = 0.06  # from which neighbours differ, in square roots of brightness
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
RAYS_AT_ONCE = 1 << 17  # whose arrays roughly fit into the processor's caches
SKY_GRID_PX = 4  # skylight varies slowly: it is sampled at every fourth pixel of every fourth row
SKY_DIRECTIONS = 20
MIN_SKY_SHARE = 0.35  # share of light at a point that sees no sky: its surroundings reflect some


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """A view of the static world; P pixels, numbered row by row."""

    pose: Poses  # of the optical frame in the world, a single one
    directions: F32  # (P, 3) unit vectors in the world
    distance: F32  # (P,) metres; infinite for the sky, 0 outside the lens
    points: F32  # (P, 3) slightly above the surface
    shading: Shading  # without sun in the shadow of the static world
    linear: F32  # (P, 3) sum of all light
    nearest: F32  # (P,) least distance of each pixel and its neighbours, metres
    lowest_m: float  # height of the lowest visible point


def take_still(scene: Scene, light: Light, lens: Lens, pose: Poses) -> Still:
    """Render every pixel of a view, those that differ from their neighbours with four samples."""
    directions = mapped(lens.directions, pose.rotation[0])
    n = len(directions)
    distance, points = np.empty(n, np.float32), np.empty((n, 3), np.float32)
    rest, sun = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    normals = np.empty((n, 3), np.float32)
    for first in range(0, n, RAYS_AT_ONCE):
        rows = slice(first, first + RAYS_AT_ONCE)
        surfaces = scene.static.surfaces(pose.translation[0], directions[rows])
        shading = lit_surfaces(scene, light, surfaces)
        points[rows], distance[rows] = surfaces.points, surfaces.distance
        rest[rows], sun[rows], normals[rows] = shading.rest, shading.sun, surfaces.normal
    mixed = np.flatnonzero(contrasts((rest + sun).reshape(lens.height, lens.width, 3)) & _inner(lens))
    for first in range(0, len(mixed), RAYS_AT_ONCE // 4):
        pixels = mixed[first : first + RAYS_AT_ONCE // 4]
        offset_by = [lens.directions_beside(pixels, offset) for offset in BESIDE_PX]
        beside = mapped(np.concatenate(offset_by), pose.rotation[0])
        shading = lit_surfaces(scene, light, scene.static.surfaces(pose.translation[0], beside))
        rest[pixels] = shading.rest.reshape(4, -1, 3).mean(0)
        sun[pixels] = shading.sun.reshape(4, -1, 3).mean(0)
    image = (lens.height, lens.width, 3)
    share = sky_light(scene, points.reshape(image), normals.reshape(image)).reshape(-1)
    left = 1 - (1 - share) * light.clearness(distance)  # neither haze in front of a surface nor the sky is darkened
    rest *= left[:, None]
    distance[~lens.covered], rest[~lens.covered], sun[~lens.covered] = 0.0, 0.0, 0.0
    seen = np.isfinite(distance) & lens.covered
    lowest_m = min(float(points[:, 2].compress(seen).min(initial=np.inf)), float(pose.translation[0, 2]))
    around = cv2.erode(distance.reshape(lens.height, lens.width), np.ones((3, 3), np.uint8))
    nearest = np.asarray(around, np.float32).reshape(-1)
    return Still(pose, directions, distance, points, Shading(rest, sun), rest + sun, nearest, lowest_m)


def lit_surfaces(scene: Scene, light: Light, surfaces: Surfaces) -> Shading:
    """Light from surfaces, or from the sky for a miss, with the shadows of the static world."""
    hit = np.isfinite(surfaces.distance)
    if not hit.all():
        n = len(hit)
        rest, sun = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
        rows, free = np.flatnonzero(hit), np.flatnonzero(~hit)
        rest[free] = light.sky(surfaces.directions.take(free, 0))
        if len(rows):
            shading = lit_surfaces(scene, light, surfaces.select(rows))
            rest[rows], sun[rows] = shading.rest, shading.sun
        return Shading(rest, sun)
    albedo = surface_rgb(scene.palette, surfaces.material, surfaces.local, surfaces.normal)
    shading = light.surface(albedo, surfaces.material, surfaces.normal, surfaces.directions, surfaces.distance)
    if light.shadows:
        facing = np.flatnonzero(shading.sun[:, 1] > 0)
        points = surfaces.select(facing).points
        shading.sun[facing.compress(scene.static.occludes(points, light.towards))] = 0.0
    return shading


def contrasts(linear: F32) -> Bools:
    """Whether pixels of an image (H, W, 3) of light differ from a neighbour: (H * W,)."""
    brightness = np.sqrt(linear @ LUMINANCE)
    square = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(brightness, square) - cv2.erode(brightness, square) > MIN_CONTRAST).reshape(-1)


def _inner(lens: Lens) -> Bools:
    """Whether the lens covers a pixel and all its neighbours."""
    covered = lens.covered.reshape(lens.height, lens.width).astype(np.uint8)
    return cv2.erode(covered, np.ones((3, 3), np.uint8)).reshape(-1) > 0


def sky_light(scene: Scene, points: F32, normals: F32) -> F32:
    """Share (H, W) of skylight, at most 1, that the static world lets through to the surface of each pixel.

    The points (H, W, 3) lie slightly above the surface; its normals (H, W, 3) are 0 where there is none.
    """
    height, width, _ = points.shape
    rows, columns = np.arange(SKY_GRID_PX // 2, height, SKY_GRID_PX), np.arange(SKY_GRID_PX // 2, width, SKY_GRID_PX)
    if not len(rows) or not len(columns):
        return np.ones((height, width), np.float32)
    grid = np.ix_(rows, columns)
    starts, up = points[grid].reshape(-1, 3), normals[grid].reshape(-1, 3)
    z_axis, x_axis = np.eye(3, dtype=np.float32)[[2, 0]]
    across = np.cross(up, np.where(np.abs(up[:, 2:]) < 0.9, z_axis, x_axis))
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.float32(1e-9))
    along = np.cross(up, across)
    free, asked = np.zeros(len(up)), np.zeros(len(up))
    for step in range(SKY_DIRECTIONS):
        # A sunflower disc projected to the half sphere: the density follows Lambert's law.
        radius, turn = np.sqrt((step + 0.5) / SKY_DIRECTIONS), step * np.pi * (3 - np.sqrt(5))
        x, y, z = radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius * radius)
        directions = x * across + y * along + z * up
        asking = np.flatnonzero(directions[:, 2] > 0.02)  # light from the ground is not skylight
        blocked = scene.static.occludes(starts.take(asking, 0), directions.take(asking, 0))
        asked[asking] += 1
        free[asking] += ~blocked
    share = np.where(asked > 0, free / np.maximum(asked, 1), 1.0).astype(np.float32).reshape(len(rows), len(columns))
    smooth = cv2.resize(cv2.blur(share, (3, 3)), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(MIN_SKY_SHARE + (1 - MIN_SKY_SHARE) * smooth, np.float32)
