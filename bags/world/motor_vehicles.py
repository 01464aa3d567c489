"""Bodies of motor vehicles by shape; their front wheels are apart, as they steer."""

from collections.abc import Callable, Mapping

from bags.world.buses import bus
from bags.world.cars import car, model_car
from bags.world.mesh import Mesh
from bags.world.trucks import truck
from bags.world.vans import van

__all__ = ["BODIES"]

Rgb = tuple[float, float, float]

BODIES: Mapping[str, Callable[[Rgb], Mesh]] = {
    "model_car": model_car,
    "car": car,
    "van": van,
    "truck": truck,
    "bus": bus,
}
"""By shape: the body in a colour, with its rear wheels, in the base frame."""
