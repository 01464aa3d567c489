"""Rays against oriented boxes by the slab method (Kay and Kajiya 1986): apart from the simulator's ray caster."""

import numpy as np

from pipeline.core.arrays import F64

__all__ = ["distance_to_box"]


def distance_to_box(origins: F64, directions: F64, center: F64, size: F64, yaw: float) -> F64:
    """Distance (N,) to an upright box along each ray, infinite for a miss or from inside.

    Args:
        origins: (N, 3) or (3,) metres.
        directions: (N, 3) unit vectors.
        center: (3,) of the box.
        size: (3,) length, width, height.
        yaw: About +z, radians.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    start = np.broadcast_to(origins - center, directions.shape) @ turn.T
    along = directions @ turn.T
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    enter = ((-np.sign(along) * size / 2 - start) / along).max(1)
    leave = ((np.sign(along) * size / 2 - start) / along).min(1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)
