"""How much of the sky's light reaches surfaces between other things (ambient occlusion), on a coarse grid of pixels."""

import cv2
import numpy as np

from bags.simulator.world.scene import Scene
from pipeline.core.arrays import F32

__all__ = ["sky_light"]


GRID_PX = 4
"""The sky's light changes slowly over a surface: it is worked out for every fourth pixel of every fourth row."""
DIRECTIONS = 20
AXIS_X, AXIS_Z = np.array([1, 0, 0], np.float32), np.array([0, 0, 1], np.float32)
LEAST = 0.35
"""Share of the light that reaches a point that sees no sky at all: what is around it sends some back."""


def sky_light(scene: Scene, points: F32, normals: F32) -> F32:
    """Share (H, W) of the sky's light, at most 1, that comes past what stands still to what pixels show.

    Args:
        scene: The world.
        points: (H, W, 3) metres, a little above the surface.
        normals: (H, W, 3) of the surface; 0 where there is none.
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
        # Points of a sunflower's disc, lifted to the half sphere: as dense as Lambert's law weighs them.
        radius, turn = np.sqrt((step + 0.5) / DIRECTIONS), step * np.pi * (3 - np.sqrt(5))
        x, y, z = radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius * radius)
        directions = x * across + y * along + z * up
        asking = np.flatnonzero(directions[:, 2] > 0.02)  # the ground's light does not come from the sky
        blocked = scene.static_occludes(starts.take(asking, 0), directions.take(asking, 0))
        asked[asking] += 1
        free[asking] += ~blocked
    share = np.where(asked > 0, free / np.maximum(asked, 1), 1.0).astype(np.float32).reshape(len(rows), len(columns))
    smooth = cv2.resize(cv2.blur(share, (3, 3)), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(LEAST + (1 - LEAST) * smooth, np.float32)
