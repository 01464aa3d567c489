"""The chassis of motor vehicles: wheels, axles, floor."""

from collections.abc import Mapping

from bags.simulator.world.bodies.dimensions import SHAPES, Shape
from bags.simulator.world.meshes.lofts import wheel
from bags.simulator.world.meshes.materials import DARK, HUB, RUBBER, SILVER
from bags.simulator.world.meshes.mesh import Mesh, box, cylinder, merged

__all__ = ["front_wheel", "rear_wheels", "underbody"]

TYRE_WIDTH_M: Mapping[str, float] = {"model_car": 0.027, "car": 0.20, "van": 0.22, "truck": 0.28, "bus": 0.28}


def front_wheel(name: str) -> Mesh:
    """A wheel of a shape with its centre at the origin."""
    sides = 28 if SHAPES[name].wheel_radius_m > 0.4 else 20
    return wheel(SHAPES[name].wheel_radius_m, TYRE_WIDTH_M[name], RUBBER, SILVER, HUB, sides=sides)


def rear_wheels(name: str, *, twin: bool = False) -> Mesh:
    """The rear wheels of a shape, single or twin, in its base frame."""
    shape = SHAPES[name]
    tyre, y = TYRE_WIDTH_M[name], shape.track_width_m / 2
    places = [y, y - 1.15 * tyre] if twin else [y]
    return merged(
        *(front_wheel(name).moved((0.0, side * place, shape.wheel_radius_m)) for side in (-1, 1) for place in places)
    )


def underbody(shape: Shape, clearance: float, half: float, top: float) -> Mesh:
    """The floor and axles between the wheels, so that nobody sees through below."""
    length = shape.front_m - shape.rear_m
    middle = (shape.front_m + shape.rear_m) / 2
    axles = [
        cylinder((x, -shape.track_width_m / 2, r), (x, shape.track_width_m / 2, r), 0.12 * r, DARK, sides=8)
        for x, r in ((0.0, shape.wheel_radius_m), (shape.wheel_base_m, shape.wheel_radius_m))
    ]
    floor = box((middle, 0.0, (clearance + top) / 2), (0.94 * length, 2 * half, top - clearance), DARK)
    return merged(floor, *axles)
