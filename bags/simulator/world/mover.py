"""Moving things: rigid parts on paths, and the box that is the ground truth about each of them."""

from dataclasses import dataclass

from bags.simulator.world.meshes.mesh import Mesh
from bags.simulator.world.motion import Path

__all__ = ["Mover", "Part"]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A rigid part of a mover.

    Attributes:
        mesh: In the part's own frame.
        path: Path of that frame.
    """

    mesh: Mesh
    path: Path


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A moving thing and its ground truth box.

    Attributes:
        name: Unique in the scenario.
        class_name: Ground truth class (`car`, `truck`, `bus`, `cyclist`, `pedestrian`...).
        path: Path of its base frame: on the ground, x forward.
        box_center_m: Centre of the box in the base frame.
        size_m: Length, width, height of the box; no part sticks out of it by more than a centimetre.
        parts: Its rigid parts.
    """

    name: str
    class_name: str
    path: Path
    box_center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    parts: tuple[Part, ...]
