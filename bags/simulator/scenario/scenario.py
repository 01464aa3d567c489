"""Scenarios: the settings of a simulated recording, as YAML that people copy and change.

Unknown keys are refused; names carry units. The world frame is the site frame (x forward, y left, z up). A sensor
mounted on a vehicle is placed in the vehicle's base frame (on the ground below the rear axle).
"""

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, model_validator

from lidcam.bags.simulator.scenario.open_world import GroundScenario, ThingScenario
from lidcam.bags.simulator.scenario.sensors import COEFFICIENTS, CameraScenario, LidarScenario, Name
from lidcam.bags.simulator.scenario.traffic import RouteScenario, VehicleScenario
from lidcam.pipeline.core.settings.model import NotNegative, Positive, SettingsModel

EGO_FRAME = "base_link"  # base frame of the vehicle that carries sensors (REP 105)
OWN_TOPICS = ("/tf", "/tf_static", "/odom", "/ground_truth/objects", "/ground_truth/objects_when_measured")


class RecordingScenario(SettingsModel):
    """Rates of the messages that come from no sensor."""

    # Rate of /ground_truth/objects; 0 records no ground truth at all, not that of images, either
    truth_rate_hz: NotNegative = 10.0
    odometry_rate_hz: Positive = 50.0  # rate of the vehicles' odometry and tf
    command_rate_hz: Positive = 20.0  # rate of the vehicles' commands


class SunScenario(SettingsModel):
    """The direction of sunlight."""

    azimuth_deg: float = -50.0  # counter-clockwise from +x
    elevation_deg: Annotated[float, Field(gt=0, le=90)] = 50.0  # above the horizon
    shadows: bool = True  # whether it casts shadows


class Scenario(SettingsModel):
    """A whole scenario."""

    description: str = ""  # one line for people
    world: Literal["sandbox", "crossing", "street", "open"]  # the static world; `open` is that of `ground` and `things`
    ground: GroundScenario = GroundScenario()  # the ground of an `open` world
    things: tuple[ThingScenario, ...] = ()  # what stands in an `open` world
    site_frame: str = "site"  # name of the world frame in messages
    # Start time, seconds since 1970; headers end in 2038
    start_unix_s: Annotated[int, Field(ge=0, le=2_000_000_000)] = 1_700_000_000
    duration_s: Positive = 10.0  # default length of the recording
    seed: Annotated[int, Field(ge=0)] = 1  # seed of all random numbers
    sun: SunScenario = SunScenario()  # the sun
    routes: dict[str, RouteScenario] = Field(default_factory=dict)  # routes for traffic, by name
    vehicles: dict[Name, VehicleScenario] = Field(default_factory=dict)  # vehicles, cyclists and pedestrians, by name
    lidars: dict[Name, LidarScenario] = Field(default_factory=dict)  # lidars by name
    cameras: dict[Name, CameraScenario] = Field(default_factory=dict)  # cameras by name
    recording: RecordingScenario = RecordingScenario()  # rates of all other messages

    @model_validator(mode="after")
    def _things_are_in_an_open_world(self) -> "Scenario":
        if self.world != "open" and (self.things or self.ground != GroundScenario()):
            raise ValueError(f"world: expected open for ground and things, found {self.world}")
        return self

    @model_validator(mode="after")
    def _names_lead_somewhere(self) -> "Scenario":
        for name, vehicle in self.vehicles.items():
            if vehicle.route and vehicle.route not in self.routes:
                raise ValueError(
                    f"vehicles.{name}.route: expected one of {listed(self.routes)}, found {vehicle.route!r}"
                )
            if vehicle.route and vehicle.keys:
                raise ValueError(f"vehicles.{name}: expected a route or keys, found both")
            if vehicle.shape == "pedestrian" and (vehicle.commands or vehicle.keys or vehicle.ego):
                raise ValueError(f"vehicles.{name}: expected a route for a pedestrian, found keys, commands or ego")
        for name, route in self.routes.items():
            for other in route.yields_to:
                if other not in self.routes:
                    raise ValueError(f"routes.{name}.yields_to: expected one of {listed(self.routes)}, found {other!r}")
        egos = [name for name, vehicle in self.vehicles.items() if vehicle.ego]
        if len(egos) > 1:
            raise ValueError(f"vehicles: expected at most one ego, found {listed(egos)}")
        return self

    @model_validator(mode="after")
    def _sensors_fit(self) -> "Scenario":
        for name, sensor in self.sensors.items():
            if sensor.mounted_on not in ("", self.ego):
                raise ValueError(f"{name}.mounted_on: expected the ego vehicle or nothing, found {sensor.mounted_on!r}")
        for name, lidar in ((f"lidars.{key}", value) for key, value in self.lidars.items()):
            if lidar.output != "points" and (lidar.model == "linear" or not lidar.packets_topic):
                raise ValueError(
                    f"{name}: expected a Velodyne model and a packets_topic for packets, found {lidar.model}"
                )
            if lidar.output != "points" and lidar.firing_stride != 1:
                expected = "expected 1 for packets, which hold every firing"
                raise ValueError(f"{name}.firing_stride: {expected}, found {lidar.firing_stride}")
            if lidar.elevations_deg and lidar.model != "linear":
                raise ValueError(f"{name}.elevations_deg: expected none of a {lidar.model}, which has its own")
            if lidar.elevation_deg[0] >= lidar.elevation_deg[1]:
                raise ValueError(f"{name}.elevation_deg: expected the lower one first, found {lidar.elevation_deg}")
        for name, camera in ((f"cameras.{key}", value) for key, value in self.cameras.items()):
            limit = COEFFICIENTS[camera.distortion_model]
            if len(camera.distortion) > limit:
                expected = f"expected at most {limit} coefficients for {camera.distortion_model}"
                raise ValueError(f"{name}.distortion: {expected}, found {len(camera.distortion)}")
        return self

    @model_validator(mode="after")
    def _names_are_unique(self) -> "Scenario":
        topics = [("the simulator", topic) for topic in OWN_TOPICS]
        topics += [("the simulator", topic) for name in self.cameras for topic in camera_truth_topics(name)]
        topics += [(name, topic) for name, sensor in self.sensors.items() for topic in sensor.topics]
        topics += [(name, topic) for name, vehicle in self.vehicles.items() for topic in vehicle.topics(name)]
        frames = [("the simulator", frame) for frame in (self.site_frame, EGO_FRAME, *self.vehicles)]
        frames += [(name, sensor.frame_id) for name, sensor in self.sensors.items()]
        for kind, used in (("topic", topics), ("frame", frames)):
            owner: dict[str, str] = {}
            for name, word in used:
                if word in owner and (kind == "topic" or owner[word] != name):
                    raise ValueError(f"{name}: {word!r} is also a {kind} of {owner[word]}")
                owner[word] = name
        return self

    @property
    def sensors(self) -> dict[str, LidarScenario | CameraScenario]:
        """Lidars, then cameras, by their full names, as in `lidars.top`."""
        lidars = {f"lidars.{name}": lidar for name, lidar in self.lidars.items()}
        return {**lidars, **{f"cameras.{name}": camera for name, camera in self.cameras.items()}}

    @property
    def ego(self) -> str:
        """Name of the vehicle that carries the sensors; empty if they are fixed to the site."""
        return next((name for name, vehicle in self.vehicles.items() if vehicle.ego), "")

    @property
    def start_ns(self) -> int:
        """Start time."""
        return self.start_unix_s * 10**9


def camera_truth_topics(camera: str) -> tuple[str, str]:
    """Topics of the ground truth in a camera's images: boxes of what is visible, and of whole objects."""
    return f"/ground_truth/{camera}/visible", f"/ground_truth/{camera}/whole"


def listed(names: Iterable[str]) -> str:
    """Names in an error message."""
    return ", ".join(names) or "none"
