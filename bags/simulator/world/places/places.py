"""What stands still, by the name of the world, and how high its ground is."""

from functools import cache
from typing import Literal

import numpy as np

from bags.simulator.world.meshes.mesh import Mesh
from bags.simulator.world.places.crossing import crossing, crossing_height
from bags.simulator.world.places.sandbox import sandbox
from bags.simulator.world.places.street import street, street_height
from pipeline.core.arrays import F64

__all__ = ["World", "ground_height", "static_mesh"]

World = Literal["sandbox", "crossing", "street"]


@cache
def static_mesh(world: World) -> Mesh:
    """Everything that stands still in a world, in the world's frame."""
    return {"sandbox": sandbox, "crossing": crossing, "street": street}[world]()


def ground_height(world: World, xy: F64) -> F64:
    """Heights (N,) of the ground at places (N, 2): kerbs lift pavements by 12 cm."""
    if world == "sandbox":
        return np.zeros(len(xy))
    return crossing_height(xy) if world == "crossing" else street_height(xy)
