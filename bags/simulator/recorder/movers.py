"""Movers from the vehicles of a scenario."""

from collections.abc import Callable

from bags.simulator.scenario.traffic import VehicleScenario
from bags.simulator.vehicles.trajectory import Trajectory
from bags.simulator.world.bodies.cars import car, model_car
from bags.simulator.world.bodies.commercial import bus, truck, van
from bags.simulator.world.bodies.cyclist import cyclist_parts
from bags.simulator.world.bodies.dimensions import SHAPES
from bags.simulator.world.bodies.hulls import front_wheel
from bags.simulator.world.bodies.joints import RaisedPath, steered_wheel
from bags.simulator.world.bodies.pedestrian import pedestrian_parts
from bags.simulator.world.mover import Mover, Part, UprightBox
from pipeline.core.arrays import F64

__all__ = ["build_mover"]

BODIES = {"model_car": model_car, "car": car, "van": van, "truck": truck, "bus": bus}
"""Body of each motor vehicle, made from its colour, in the base frame; the front wheels are separate parts."""


def build_mover(
    name: str, vehicle: VehicleScenario, trajectory: Trajectory, *, height: Callable[[F64], F64] | None = None
) -> Mover:
    """The mover of a vehicle, cyclist or pedestrian, whose name determines its appearance; its trajectory may grow.

    `height` gives heights (N,) of the ground at positions (N, 2), for pedestrians, who step on kerbs; None if flat.
    """
    shape = SHAPES[vehicle.shape]
    path: Trajectory | RaisedPath = trajectory
    body: UprightBox | None = UprightBox(shape.box_center_m, shape.body_size_m)
    if vehicle.shape == "pedestrian":
        path = trajectory if height is None else RaisedPath(trajectory, height)
        parts = pedestrian_parts(name, vehicle.color, path)
        body = None
    elif vehicle.shape == "cyclist":
        parts = cyclist_parts(name, vehicle.color, trajectory)
    else:
        wheel = front_wheel(vehicle.shape)
        parts = (
            Part(BODIES[vehicle.shape](vehicle.color), trajectory),
            *(Part(wheel, steered_wheel(trajectory, shape, side)) for side in (1, -1)),
        )
    return Mover(name, shape.class_name, path, shape.box_center_m, shape.size_m, parts, body)
