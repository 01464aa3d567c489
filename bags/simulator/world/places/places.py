"""The static worlds of scenarios, and the height of their ground."""

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Literal

import numpy as np

from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.world.mesh import Mesh
from lidcam.bags.simulator.world.places.crossing import crossing, crossing_height
from lidcam.bags.simulator.world.places.open_world import open_height, open_mesh
from lidcam.bags.simulator.world.places.sandbox import sandbox
from lidcam.bags.simulator.world.places.street import street, street_height
from lidcam.pipeline.core.arrays import F64

World = Literal["sandbox", "crossing", "street"]
HEIGHTS: Mapping[World, Callable[[F64], F64]] = {
    "sandbox": lambda xy: np.zeros(len(xy)),
    "crossing": crossing_height,
    "street": street_height,
}
"""From positions (N, 2) to heights (N,) of the ground of a world: pavements are 12 cm above roads."""


def mesh_of(scenario: Scenario) -> Mesh:
    """The static mesh of a scenario's world, in the world frame."""
    if scenario.world == "open":
        return open_mesh(scenario.ground, scenario.things)
    return static_mesh(scenario.world)


def height_of(scenario: Scenario) -> Callable[[F64], F64]:
    """From positions (N, 2) to heights (N,) of the ground of a scenario's world."""
    return partial(open_height, scenario.ground) if scenario.world == "open" else HEIGHTS[scenario.world]


@cache
def static_mesh(world: World) -> Mesh:
    """The static mesh of a world, in the world frame."""
    return {"sandbox": sandbox, "crossing": crossing, "street": street}[world]()
