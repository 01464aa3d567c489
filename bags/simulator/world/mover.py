"""Moving things: rigid parts on paths, and the box that is the ground truth about each of them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidcam.bags.simulator.world.meshes.mesh import Mesh
from lidcam.bags.simulator.world.motion import Path, turned
from lidcam.pipeline.core.arrays import F64

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A rigid part of a mover.

    Attributes:
        mesh: In the part's own frame.
        path: Path of that frame.
    """

    mesh: Mesh
    path: Path


class UprightBox(NamedTuple):
    """An upright box in the base frame of a mover.

    Attributes:
        center_m: Its centre.
        size_m: Length, width, height.
    """

    center_m: Vector
    size_m: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A moving thing and its ground truth box.

    Attributes:
        name: Unique in the scenario.
        class_name: Ground truth class (`car`, `truck`, `bus`, `cyclist`, `pedestrian`...).
        path: Path of its base frame: on the ground, x forward.
        box_center_m: Centre of a box that holds it at all times, in the base frame.
        size_m: Length, width, height of that box; no part sticks out of it by more than a centimetre.
        parts: Its rigid parts.
        body: Its ground truth box, which need not hold mirrors; None for people, whose limbs swing: then it is the
            smallest one around all parts at each moment.
    """

    name: str
    class_name: str
    path: Path
    box_center_m: Vector
    size_m: Vector
    parts: tuple[Part, ...]
    body: UprightBox | None

    def body_at(self, time_ns: int) -> UprightBox:
        """Its ground truth box at a time."""
        if self.body is not None:
            return self.body
        to_base = self.path.poses(np.array([time_ns], np.int64)).inverse()
        vertices = to_base.apply(np.concatenate([placed_vertices(part, time_ns) for part in self.parts]))
        low, high = vertices.min(0), vertices.max(0)
        (x, y, z), (length, width, height) = ((low + high) / 2).tolist(), (high - low).tolist()
        return UprightBox((x, y, z), (length, width, height))


def placed_vertices(part: Part, time_ns: int) -> F64:
    """The vertices (V, 3) of a part in the world at a time."""
    pose = part.path.poses(np.array([time_ns], np.int64))
    return np.asarray(turned(pose.rotation, part.mesh.vertices) + pose.translation)
