"""Static obstacles for cars."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from bags.simulator.vehicles.footprints import Rectangle
from bags.simulator.world.meshes.mesh import Mesh
from pipeline.core.arrays import F64

__all__ = ["Obstacles", "obstacles_of"]


def obstacles_of(world: Mesh, *, step_m: float, headroom_m: float) -> tuple[Rectangle, ...]:
    """The footprints of the bodies in a static world that a car cannot pass.

    Args:
        world: Mesh of bodies that share no vertices; each is taken as convex.
        step_m: Bodies no higher than this are driven over, as kerbs are.
        headroom_m: Bodies that start higher are driven under, as tree crowns are.
    """
    count = len(world.vertices)
    first, others = np.repeat(world.triangles[:, 0], 2), world.triangles[:, 1:].ravel()
    links = csr_array((np.ones(len(first)), (first, others)), shape=(count, count))
    bodies, body = connected_components(links, directed=False)
    order = np.argsort(body, kind="stable")
    starts = np.searchsorted(body[order], np.arange(bodies + 1))
    z = world.vertices[order, 2]
    low, high = np.minimum.reduceat(z, starts[:-1]), np.maximum.reduceat(z, starts[:-1])
    standing = np.flatnonzero((high > step_m) & (low < headroom_m))
    return tuple(_under(world.vertices[order[starts[row] : starts[row + 1]], :2]) for row in standing)


class Obstacles:
    """Rectangles with a lookup by position."""

    def __init__(self, rectangles: Sequence[Rectangle]) -> None:
        self.rectangles = tuple(rectangles)
        columns = [(r.x_m, r.y_m, np.cos(r.yaw_rad), np.sin(r.yaw_rad), r.length_m, r.width_m) for r in rectangles]
        self._table = np.array(columns, np.float64).reshape(-1, 6).T

    def near(self, x_m: float, y_m: float, reach_m: float) -> Iterator[Rectangle]:
        """The rectangles within reach of a position."""
        x, y, cos, sin, length, width = self._table
        dx, dy = x_m - x, y_m - y
        along = np.maximum(np.abs(dx * cos + dy * sin) - length / 2, 0.0)
        across = np.maximum(np.abs(dy * cos - dx * sin) - width / 2, 0.0)
        for row in np.flatnonzero(along**2 + across**2 < reach_m**2):
            yield self.rectangles[row]


def _under(corners: F64) -> Rectangle:
    """The smallest rectangle around points (N, 2), of any yaw."""
    middle = corners.mean(0)  # OpenCV uses single precision: stay near the origin
    (x, y), (length, width), turn_deg = cv2.minAreaRect((corners - middle).astype(np.float32))
    return Rectangle(
        float(x + middle[0]), float(y + middle[1]), float(np.deg2rad(turn_deg)), float(length), float(width)
    )
