"""The world of a scenario, with all poses over time."""

from collections.abc import Callable, Collection

import numpy as np

from lidcam.bags.simulator.recorder.movers import build_mover
from lidcam.bags.simulator.recorder.true_rig import carrier_frame
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.scenario.sensors import SensorScenario
from lidcam.bags.simulator.vehicles.traffic import Traffic
from lidcam.bags.simulator.world.bodies.dimensions import shape_of
from lidcam.bags.simulator.world.bodies.joints import Carrier, RaisedPath
from lidcam.bags.simulator.world.motion import FixedPath, MountedPath, Path
from lidcam.bags.simulator.world.places.places import height_of, mesh_of
from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.transform import Transform

KEPT_NS = 1_000_000_000  # the past is kept for this long beyond what measurements under way need


class Stage:
    """The world of a scenario in motion; call `traffic.advance` before asking for a later time.

    The vehicles in `driven` wait at their start for `traffic.command`. `vehicles` are all but the ego one, in the order
    of `scene.movers`; no measurement spans more time than `longest_ns`.
    """

    def __init__(self, scenario: Scenario, *, driven: Collection[str] = ()) -> None:
        self.scenario = scenario
        world = mesh_of(scenario)
        self.traffic = Traffic(scenario, driven=driven, static=world)
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
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = pose.rotation[0], pose.translation[0]
        return Transform(self.scenario.site_frame, frame, matrix)

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
        center = np.eye(4)
        center[:3, 3] = center_m
        base = self.T_site_base(vehicle, frame, time_ns)
        return Transform(base.dst, frame, base.matrix @ center)

    def forget(self, before_ns: int) -> None:
        """Drop the past that no measurement or message after `before_ns` needs."""
        self.traffic.forget(before_ns - 2 * self.longest_ns - KEPT_NS)
