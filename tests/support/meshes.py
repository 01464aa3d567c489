"""What several tests ask of a mesh."""

import numpy as np

from lidcam.bags.simulator.world.mesh import Mesh


def signed_volume(mesh: Mesh) -> float:
    """By the divergence theorem; positive where all triangles run counter-clockwise seen from outside."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def open_edges(mesh: Mesh) -> int:
    """How many edges of triangles are not run through once in either direction."""
    edges = np.concatenate([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]])
    count = len(mesh.vertices)
    there, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    return len(np.setxor1d(there, back)) + len(there) - len(np.unique(there))
