"""Ambient occlusion: the share of skylight that reaches surfaces, on a coarse pixel grid."""

import cv2
import numpy as np

from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.arrays import F32

GRID_PX = 4
"""Skylight varies slowly: it is sampled at every fourth pixel of every fourth row."""
DIRECTIONS = 20
AXIS_X, AXIS_Z = np.array([1, 0, 0], np.float32), np.array([0, 0, 1], np.float32)
MIN_SHARE = 0.35
"""Share of light at a point that sees no sky: its surroundings reflect some."""


def sky_light(scene: Scene, points: F32, normals: F32) -> F32:
    """Share (H, W) of skylight, at most 1, that the static world lets through to the surface of each pixel.

    The points (H, W, 3) lie slightly above the surface; its normals (H, W, 3) are 0 where there is none.
    """
    height, width, _ = points.shape
    rows, columns = np.arange(GRID_PX // 2, height, GRID_PX), np.arange(GRID_PX // 2, width, GRID_PX)
    if not len(rows) or not len(columns):
        return np.ones((height, width), np.float32)
    grid = np.ix_(rows, columns)
    starts, up = points[grid].reshape(-1, 3), normals[grid].reshape(-1, 3)
    across = np.cross(up, np.where(np.abs(up[:, 2:]) < 0.9, AXIS_Z, AXIS_X))
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.float32(1e-9))
    along = np.cross(up, across)
    free, asked = np.zeros(len(up)), np.zeros(len(up))
    for step in range(DIRECTIONS):
        # A sunflower disc projected to the half sphere: the density follows Lambert's law.
        radius, turn = np.sqrt((step + 0.5) / DIRECTIONS), step * np.pi * (3 - np.sqrt(5))
        x, y, z = radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius * radius)
        directions = x * across + y * along + z * up
        asking = np.flatnonzero(directions[:, 2] > 0.02)  # light from the ground is not skylight
        blocked = scene.static_occludes(starts.take(asking, 0), directions.take(asking, 0))
        asked[asking] += 1
        free[asking] += ~blocked
    share = np.where(asked > 0, free / np.maximum(asked, 1), 1.0).astype(np.float32).reshape(len(rows), len(columns))
    smooth = cv2.resize(cv2.blur(share, (3, 3)), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(MIN_SHARE + (1 - MIN_SHARE) * smooth, np.float32)
