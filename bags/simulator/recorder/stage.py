"""The world of a scenario: its movers, all poses over time, and the calibration, true and recorded."""

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from lidcam.bags.simulator.scenario.scenario import EGO_FRAME, Scenario, VehicleScenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario, SensorScenario
from lidcam.bags.simulator.sensors.lens import camera_model
from lidcam.bags.simulator.vehicles.traffic import Traffic
from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, shape_of
from lidcam.bags.simulator.world.bodies.motor_vehicles import PAINT, front_wheel, motor_vehicle, steered_wheel
from lidcam.bags.simulator.world.bodies.people import cyclist_parts, pedestrian_parts
from lidcam.bags.simulator.world.mesh import Mesh, paint
from lidcam.bags.simulator.world.motion import (
    T_BODY_OPTICAL,
    ArticulatedPath,
    Carrier,
    FixedPath,
    MountedPath,
    Mover,
    Part,
    Path,
    RaisedPath,
    UprightBox,
)
from lidcam.bags.simulator.world.places.places import height_of, mesh_of
from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig, default_zones


def carrier_frame(scenario: Scenario, sensor: SensorScenario) -> str:
    """The frame that one sensor is mounted in."""
    return EGO_FRAME if sensor.mounted_on else scenario.site_frame


def T_carrier_sensor(scenario: Scenario, sensor: SensorScenario) -> Transform:
    """The true pose of the sensor's frame (for a camera the optical frame) on its carrier."""
    return _framed(sensor.T_carrier_body(carrier_frame(scenario, sensor)), sensor)


def recorded_extrinsics(scenario: Scenario) -> list[Transform]:
    """The transforms in /tf_static, whose errors are those of the scenario."""
    sensors = scenario.sensors.values()
    return [_framed(sensor.T_carrier_recorded(carrier_frame(scenario, sensor)), sensor) for sensor in sensors]


def _framed(body: Transform, sensor: SensorScenario) -> Transform:
    """The same pose for the frame of the sensor's messages."""
    if not isinstance(sensor, CameraScenario):
        return body
    return Transform(body.dst, body.src, body.matrix @ T_BODY_OPTICAL.matrix)


def true_rig(scenario: Scenario) -> Rig:
    """The true rig: the sensors of the ego vehicle if there is one, else those of the site.

    The sandbox has the zones of the predecessor system.
    """
    frame = EGO_FRAME if scenario.ego else scenario.site_frame
    lidars = [
        LidarSensor(name, lidar.topics[0], T_carrier_sensor(scenario, lidar))
        for name, lidar in scenario.lidars.items()
        if carrier_frame(scenario, lidar) == frame
    ]
    cameras = []
    for name, camera in scenario.cameras.items():
        if carrier_frame(scenario, camera) == frame:
            boxes_topic = camera.detector.topic if camera.detector else ""
            T_camera_carrier = T_carrier_sensor(scenario, camera).inverse()
            cameras.append(CameraSensor(name, camera.image_topic, boxes_topic, camera_model(camera), T_camera_carrier))
    zones = default_zones() if scenario.world == "sandbox" else ()
    return Rig(frame, tuple(lidars), tuple(cameras), zones, ground_height_m=0.0)


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
        chassis = motor_vehicle(vehicle.shape, vehicle.body).recolored({PAINT: paint(vehicle.color)})
        wheel, unscaled = front_wheel(vehicle.shape), SHAPES[vehicle.shape]
        wheels = (Part(wheel, steered_wheel(trajectory, unscaled, side)) for side in (1, -1))
        parts = (Part(chassis, trajectory), *wheels)
    if vehicle.scale != (1.0, 1.0, 1.0):
        parts = tuple(_scaled(part, vehicle.scale) for part in parts)
    return Mover(name, shape.class_name, path, shape.box_center_m, shape.size_m, parts, body)


def _scaled(part: Part, scale: tuple[float, float, float]) -> Part:
    """A part of a mover that is larger or smaller by factors along x, y and z."""
    mesh, path = part.mesh, part.path
    if isinstance(path, ArticulatedPath):
        path = replace(path, scale=scale)
    return Part(Mesh(mesh.vertices * scale, mesh.triangles, mesh.materials, mesh.palette), path)


KEPT_NS = 1_000_000_000  # the past is kept for this long beyond what measurements under way need


class Stage:
    """The world of a scenario in motion; call `traffic.advance` before asking for a later time.

    The vehicles in `driven` wait at their start for `traffic.command`. `vehicles` are all but the ego one, in the order
    of `scene.movers`; no measurement spans more time than `longest_ns`.
    """

    def __init__(self, scenario: Scenario, *, driven: Collection[str] = ()) -> None:
        self.scenario = scenario
        world = mesh_of(scenario)
        self.traffic = Traffic(scenario, driven=driven)
        self.vehicles = {name: vehicle for name, vehicle in scenario.vehicles.items() if not vehicle.ego}
        self._carriers: dict[str, Carrier] = dict(self.traffic.trajectories)
        kerbs: Callable[[F64], F64] | None = height_of(scenario)
        if scenario.world == "open":  # where vehicles follow the ground, too
            self._carriers = {name: RaisedPath(path, height_of(scenario)) for name, path in self._carriers.items()}
            kerbs = None
        movers = [
            build_mover(name, vehicle, self._carriers[name], height=kerbs) for name, vehicle in self.vehicles.items()
        ]
        self._paths: dict[str, Path] = dict(self._carriers) | {mover.name: mover.path for mover in movers}
        self.scene = Scene(world, movers)
        periods_s = [1 / sensor.rate_hz for sensor in scenario.sensors.values()]
        self.longest_ns = round(1.1e9 * max(periods_s, default=0.0))  # more for jitter and sweeps of whole packets

    def sensor_path(self, sensor: SensorScenario) -> Path:
        """Path of a sensor's body (x forward)."""
        place = sensor.T_carrier_body(carrier_frame(self.scenario, sensor))
        if not sensor.mounted_on:
            return FixedPath(place)
        return MountedPath(self._carriers[sensor.mounted_on], place)

    def T_site_base(self, vehicle: str, frame: str, time_ns: int) -> Transform:
        """Pose of a vehicle's base frame, which the transform names `frame`."""
        pose = self._paths[vehicle].poses(np.array([time_ns], np.int64))
        return Transform(self.scenario.site_frame, frame, pose_matrix(pose.rotation[0], pose.translation[0]))

    def T_site_box(self, vehicle: str, frame: str, time_ns: int) -> Transform:
        """Pose of the centre of the box that holds a vehicle at all times, which the transform names `frame`."""
        settings = self.scenario.vehicles[vehicle]
        return self._centred(vehicle, frame, time_ns, shape_of(settings.shape, settings.scale).box_center_m)

    def body_box(self, row: int, time_ns: int) -> tuple[Transform, tuple[float, float, float]]:
        """Pose of the centre of a mover's ground truth box, and its length, width, height."""
        mover = self.scene.movers[row]
        box = mover.body_at(time_ns)
        return self._centred(mover.name, mover.name, time_ns, box.center_m), box.size_m

    def _centred(self, vehicle: str, frame: str, time_ns: int, center_m: tuple[float, float, float]) -> Transform:
        base = self.T_site_base(vehicle, frame, time_ns)
        return Transform(base.dst, frame, base.matrix @ pose_matrix(np.eye(3), center_m))

    def forget(self, before_ns: int) -> None:
        """Drop the past that no measurement or message after `before_ns` needs."""
        self.traffic.forget(before_ns - 2 * self.longest_ns - KEPT_NS)
