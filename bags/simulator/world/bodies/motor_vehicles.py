"""Bodies of motor vehicles by shape; their front wheels are apart, as they steer."""

from collections.abc import Callable, Mapping

from bags.simulator.world.bodies.buses import bus
from bags.simulator.world.bodies.cars import car, model_car
from bags.simulator.world.bodies.trucks import truck
from bags.simulator.world.bodies.vans import van
from bags.simulator.world.meshes.mesh import Mesh, Rgb

__all__ = ["BODIES"]

BODIES: Mapping[str, Callable[[Rgb], Mesh]] = {
    "model_car": model_car,
    "car": car,
    "van": van,
    "truck": truck,
    "bus": bus,
}
"""By shape: the body in a colour, with its rear wheels, in the base frame."""
