"""The static worlds by name, and the height of their ground."""

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
    """The static mesh of a world, in the world frame."""
    return {"sandbox": sandbox, "crossing": crossing, "street": street}[world]()


def ground_height(world: World, xy: F64) -> F64:
    """Heights (N,) of the ground at positions (N, 2): pavements are 12 cm above roads."""
    if world == "sandbox":
        return np.zeros(len(xy))
    return crossing_height(xy) if world == "crossing" else street_height(xy)
