"""Movers from the vehicles of a scenario."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

from lidcam.bags.simulator.scenario.traffic import VehicleScenario
from lidcam.bags.simulator.world.bodies.cars import car, model_car
from lidcam.bags.simulator.world.bodies.commercial import bus, truck, van
from lidcam.bags.simulator.world.bodies.cyclist import cyclist_parts
from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, shape_of
from lidcam.bags.simulator.world.bodies.hulls import front_wheel
from lidcam.bags.simulator.world.bodies.joints import ArticulatedPath, Carrier, RaisedPath, steered_wheel
from lidcam.bags.simulator.world.bodies.pedestrian import pedestrian_parts
from lidcam.bags.simulator.world.mesh import Mesh, paint
from lidcam.bags.simulator.world.motion import Mover, Part, UprightBox
from lidcam.pipeline.core.arrays import F64

BODIES = {"model_car": model_car, "car": car, "van": van, "truck": truck, "bus": bus}
"""Body of each motor vehicle, made from its colour, in the base frame; the front wheels are separate parts."""

REFERENCE_PAINT = (0.123, 0.456, 0.789)  # a colour that nothing else has


def build_mover(
    name: str, vehicle: VehicleScenario, trajectory: Carrier, *, height: Callable[[F64], F64] | None = None
) -> Mover:
    """The mover of a vehicle, cyclist or pedestrian, whose name determines its appearance; its trajectory may grow.

    `height` gives heights (N,) of the ground at positions (N, 2), for pedestrians, who step on kerbs; None if flat.
    """
    shape = shape_of(vehicle.shape, vehicle.scale)
    path: Carrier = trajectory
    body: UprightBox | None = UprightBox(shape.box_center_m, shape.body_size_m)
    if vehicle.shape == "pedestrian":
        path = trajectory if height is None else RaisedPath(trajectory, height)
        parts = pedestrian_parts(name, vehicle.color, path, vehicle.posture)
        body = None
    elif vehicle.shape == "cyclist":
        parts = cyclist_parts(name, vehicle.color, trajectory)
    else:
        wheel = front_wheel(vehicle.shape)
        parts = (
            Part(_body(vehicle), trajectory),
            *(Part(wheel, steered_wheel(trajectory, SHAPES[vehicle.shape], side)) for side in (1, -1)),
        )
    if vehicle.scale != (1.0, 1.0, 1.0):
        parts = tuple(_scaled(part, vehicle.scale) for part in parts)
    return Mover(name, shape.class_name, path, shape.box_center_m, shape.size_m, parts, body)


def _body(vehicle: VehicleScenario) -> Mesh:
    return _reference(vehicle.shape, vehicle.body).recolored({paint(REFERENCE_PAINT): paint(vehicle.color)})


@cache
def _reference(shape: str, body: str) -> Mesh:
    """A motor vehicle of `REFERENCE_PAINT`; making one takes far longer than painting it."""
    return car(REFERENCE_PAINT, body) if shape == "car" else BODIES[shape](REFERENCE_PAINT)


def _scaled(part: Part, scale: tuple[float, float, float]) -> Part:
    """A part of a mover that is larger or smaller by factors along x, y and z."""
    mesh, path = part.mesh, part.path
    if isinstance(path, ArticulatedPath):
        path = replace(path, scale=scale)
    return Part(Mesh(mesh.vertices * scale, mesh.triangles, mesh.materials, mesh.palette), path)
