"""Rays against oriented boxes: enough of a world for a small sample recording."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Box", "cast"]

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Box:
    """One oriented box that stands upright.

    Attributes:
        center: x, y, z in metres.
        size: Length, width, height in metres.
        yaw: About +z, radians.
        rgb: Colour, each in [0, 1].
    """

    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0
    rgb: tuple[float, float, float] = (0.5, 0.5, 0.5)


def cast(origins: F64, directions: F64, center: F64, size: F64, yaw: F64 | float) -> tuple[F64, F64]:
    """Distance to one box along each ray, and the normal of the face that it meets (slab method, Kay and Kajiya 1986).

    Args:
        origins: (N, 3) or (3,) metres.
        directions: (N, 3) unit vectors.
        center: (3,), or (N, 3) where the box moves between rays.
        size: (3,).
        yaw: Of the box; (N,) where it turns between rays.

    Returns:
        (N,) metres, infinite for a miss or from inside, and (N, 3) unit normals.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    offset = np.broadcast_to(origins - center, directions.shape)
    start = np.stack(
        [offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin, offset[:, 2]], 1
    )
    along = np.stack(
        [
            directions[:, 0] * cos + directions[:, 1] * sin,
            directions[:, 1] * cos - directions[:, 0] * sin,
            directions[:, 2],
        ],
        1,
    )
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    near = (-np.sign(along) * size / 2 - start) / along
    far = (np.sign(along) * size / 2 - start) / along
    enter, leave = near.max(1), far.min(1)
    distance = np.where((enter <= leave) & (enter > 0), enter, np.inf)
    axis = near.argmax(1)
    local = np.zeros_like(along)
    rows = np.arange(len(along))
    local[rows, axis] = -np.sign(along[rows, axis])
    normal = np.stack([local[:, 0] * cos - local[:, 1] * sin, local[:, 0] * sin + local[:, 1] * cos, local[:, 2]], 1)
    return distance, normal
