"""The world of a scenario, with all poses over time."""

from collections.abc import Collection

import numpy as np

from lidcam.bags.simulator.recorder.movers import build_mover
from lidcam.bags.simulator.recorder.true_rig import carrier_frame
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.scenario.sensors import SensorScenario
from lidcam.bags.simulator.vehicles.traffic import Traffic
from lidcam.bags.simulator.world.bodies.dimensions import shape_of
from lidcam.bags.simulator.world.bodies.joints import RaisedPath
from lidcam.bags.simulator.world.motion import FixedPath, MountedPath, Path
from lidcam.bags.simulator.world.places.places import height_of, mesh_of
from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.geometry.transform import Transform

KEPT_NS = 1_000_000_000
"""The past is kept for this long beyond what measurements under way need."""


class Stage:
    """The world of a scenario in motion.

    The vehicles in `driven` wait at their start for `traffic.command`.

    Attributes:
        scenario: The scenario.
        traffic: The traffic; call `traffic.advance` before asking for a later time.
        vehicles: All vehicles but the ego one, in the order of `scene.movers`.
        scene: The scene to cast rays into.
        longest_ns: No measurement spans more time than this.
    """

    def __init__(self, scenario: Scenario, *, driven: Collection[str] = ()) -> None:
        self.scenario = scenario
        world = mesh_of(scenario)
        self.traffic = Traffic(scenario, driven=driven, static=world)
        self.vehicles = {name: vehicle for name, vehicle in scenario.vehicles.items() if not vehicle.ego}
        trajectories = self.traffic.trajectories
        height = height_of(scenario)
        # Only in open worlds is there any other way up than a pedestrian's steps on kerbs.
        self._carriers = {
            name: RaisedPath(path, height) if scenario.world == "open" else path for name, path in trajectories.items()
        }
        movers = [
            build_mover(name, vehicle, self._carriers[name], height=None if scenario.world == "open" else height)
            for name, vehicle in self.vehicles.items()
        ]
        self._paths: dict[str, Path] = dict(self._carriers) | {mover.name: mover.path for mover in movers}
        self.scene = Scene(world, movers)
        periods_s = [1 / sensor.rate_hz for sensor in scenario.sensors.values()]
        # A tenth more, for jitter and sweeps of whole packets.
        self.longest_ns = round(1.1e9 * max(periods_s, default=0.0))

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
