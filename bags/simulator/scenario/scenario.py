"""Scenarios: the settings of a simulated recording, as YAML that people copy and change.

Unknown keys are refused; names carry units. The world frame is the site frame (x forward, y left, z up). A sensor
mounted on a vehicle is placed in the vehicle's base frame (on the ground below the rear axle).
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from lidcam.bags.simulator.scenario.sensors import CameraScenario, LidarScenario, Metres, Name
from lidcam.pipeline.core.camera import COEFFICIENTS
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.bounded_yaml import read_yaml
from lidcam.pipeline.core.settings.bundled import bundled
from lidcam.pipeline.core.settings.load import set_values
from lidcam.pipeline.core.settings.model import NotNegative, Positive, SettingsModel, Share
from lidcam.pipeline.core.settings.validation import checked, did_you_mean

ThingKind = Literal[
    "box", "cylinder", "cone", "lump", "fence", "bicycle", "tree", "conifer", "bush", "hedge", "grass", "table"
]


class RoadScenario(SettingsModel):
    """A straight road."""

    from_m: tuple[Metres, Metres]  # x, y of one end of its middle line
    to_m: tuple[Metres, Metres]  # x, y of the other
    width_m: Positive = 7.0  # from kerb to kerb


class GroundScenario(SettingsModel):
    """The ground of an `open` world."""

    reach_m: Positive = 120.0  # it reaches this far from the origin along x and y
    roads: tuple[RoadScenario, ...] = ()  # roads, which are of asphalt
    kerb_m: NotNegative = 0.12  # height of all other ground above the roads
    # Rise per metre along x and y
    slope: tuple[Annotated[float, Field(ge=-0.2, le=0.2)], Annotated[float, Field(ge=-0.2, le=0.2)]] = (0.0, 0.0)
    waves_m: NotNegative = 0.0  # height of its gentle waves
    wave_length_m: Positive = 60.0  # their length
    # Standard deviation of the height of small bumps beside the roads; a quarter of it on them
    roughness_m: NotNegative = 0.0
    seed: Annotated[int, Field(ge=0)] = 0  # of waves and bumps


class ThingScenario(SettingsModel):
    """A thing that stands in an `open` world."""

    # Its form. `lump` is a heap, `bicycle` a parked one. Of `tree`, `conifer`, `bush`, `hedge` and `grass` a lidar sees
    # single leaves, and some of what is behind.
    kind: ThingKind = "box"
    position_m: tuple[Metres, Metres]  # x, y of its middle
    size_m: tuple[Positive, Positive, Positive]  # length, width, height
    yaw_deg: float = 0.0  # direction of its length, counter-clockwise from x
    bottom_m: NotNegative = 0.0  # height of its lower end above the ground
    color: tuple[Share, Share, Share] = (0.5, 0.5, 0.5)  # sRGB, each in [0, 1]
    # Share of a lidar's light that it reflects; above 1 for a retroreflector, as signs are
    reflectivity: Annotated[float, Field(ge=0, le=10)] = 0.3


CarBody = Literal["hatchback", "saloon", "estate", "mpv"]
Posture = Literal["upright", "sitting", "stooping", "reaching"]
Scale = Annotated[float, Field(ge=0.3, le=3)]

CONTROLLERS = (
    *(f"{wheel}_wheel_velocity_controller" for wheel in ("left_rear", "right_rear", "left_front", "right_front")),
    *(f"{side}_steering_hinge_position_controller" for side in ("left", "right")),
)
"""Names of the controllers, as in the predecessor system, in the order of their commands."""


class RouteScenario(SettingsModel):
    """A route that traffic follows."""

    # Corners x, y, which are rounded. A third number is the radius of that corner.
    points_m: tuple[tuple[Metres, Metres] | tuple[Metres, Metres, NotNegative], ...]
    closed: bool = False  # whether the last point leads back to the first
    corner_radius_m: NotNegative = 5.0  # radius of all other corners
    yields_to: tuple[str, ...] = ()  # routes whose traffic has right of way where the two cross


class VehicleScenario(SettingsModel):
    """A vehicle, cyclist or pedestrian: its looks, start and driver."""

    # Its body (`lidcam.bags.simulator.world.bodies.dimensions`)
    shape: Literal["model_car", "car", "van", "truck", "bus", "cyclist", "pedestrian"] = "car"
    color: tuple[Share, Share, Share] = (0.6, 0.1, 0.1)  # colour of its paint or jacket, each in [0, 1]
    # Factors of the length, width and height of its shape; for people about the same in all three
    scale: tuple[Scale, Scale, Scale] = (1.0, 1.0, 1.0)
    body: CarBody = "hatchback"  # form of a `car`
    posture: Posture = "upright"  # of a `pedestrian`; only an upright one walks
    walked_m: NotNegative = 0.0  # distance that it has covered at the start, which decides how its legs stand
    # x, y in metres and yaw in degrees of its base frame (below the rear axle, or below the middle of a pedestrian);
    # with a route it is used only under remote control (`lidcam drive`)
    start: tuple[Metres, Metres, float] = (0.0, 0.0, 0.0)
    route: str = ""  # name of a route to follow
    route_start_m: NotNegative = 0.0  # start position along the route
    speed_m_s: NotNegative = 0.0  # cruising speed on the route
    keys: str = ""  # keys that drive it instead (`w s a d x`), one every `key_interval_s` from the start
    key_interval_s: Positive = 0.5  # time from one key to the next
    # Record nav_msgs/Odometry: the true pose of the centre of its box on /NAME/base_pose_ground_truth; for the ego
    # vehicle that of `base_link` on /odom
    odometry: bool = False
    # Record its ackermann_msgs/AckermannDriveStamped and the six Float64 commands of its controllers
    commands: bool = False
    ego: bool = False  # it carries the sensors; tf has its pose (`odom` to `base_link`), the ground truth does not

    def topics(self, name: str) -> list[str]:
        """Topics of its messages."""
        odometry = [f"/{name}/base_pose_ground_truth"] if self.odometry and not self.ego else []
        return [*odometry, *([command_topic(name), *controller_topics(name)] if self.commands else [])]


def command_topic(vehicle: str) -> str:
    """Topic of a vehicle's commands (ackermann_msgs/AckermannDriveStamped)."""
    return f"/{vehicle}/ackermann_cmd_mux/output"


def controller_topics(vehicle: str) -> tuple[str, ...]:
    """Topics of its controllers' commands (std_msgs/Float64), in the order of `CONTROLLERS`."""
    return tuple(f"/{vehicle}/{controller}/command" for controller in CONTROLLERS)


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
                known = listed(self.routes)
                raise ValueError(f"vehicles.{name}.route: expected one of {known}, found {vehicle.route!r}")
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
                expected = "expected a Velodyne model and a packets_topic for packets"
                raise ValueError(f"{name}: {expected}, found {lidar.model}")
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


def scenario_names() -> list[str]:
    """Names of the bundled scenarios."""
    return sorted(path.stem for path in bundled("scenarios").glob("*.yaml"))


def load_scenario(name: str, overrides: tuple[str, ...] = ()) -> Scenario:
    """The scenario of this name or YAML file, with overrides of single values, `a.b=value`.

    In an override `*` matches every name: `cameras.*.rate_hz=5`. Raises ConfigError if the name is unknown, the file
    cannot be read, or a key or value is not valid.
    """
    path = Path(name) if Path(name).suffix in {".yaml", ".yml"} else scenario_file(name)
    return _with(read_yaml(path), overrides, str(path))


def scenario_file(name: str) -> Path:
    """The file of a bundled scenario.

    Raises:
        ConfigError: there is none of this name.
    """
    if name not in scenario_names():
        meant = did_you_mean(name, scenario_names())
        raise ConfigError(f"{name}: expected one of {listed(scenario_names())}, or a .yaml file to simulate{meant}")
    return bundled("scenarios", f"{name}.yaml")


def overridden(scenario: Scenario, overrides: tuple[str, ...]) -> Scenario:
    """A scenario with overrides, as of `load_scenario`; raises ConfigError if a key or value is not valid."""
    return _with(scenario.model_dump(mode="json"), overrides, "the scenario") if overrides else scenario


def _with(tree: dict[str, Any], overrides: tuple[str, ...], name: str) -> Scenario:
    set_values(tree, tuple(override for given in overrides for override in _for_each(tree, given)))
    return checked(Scenario, tree, f"{name} with settings" if overrides else name)


def _for_each(tree: dict[str, Any], override: str) -> list[str]:
    """The override with each `*` in its key expanded to every name."""
    key, equals, value = override.partition("=")
    if key.startswith("*"):
        raise ConfigError(f"settings: {override}: expected a section before the first *, as in cameras.*.rate_hz")
    keys = [""]
    for part in key.split("."):
        keys = [f"{before}{name}." for before in keys for name in (_names_at(tree, before) if part == "*" else [part])]
    if not keys:
        raise ConfigError(f"settings: {override}: expected names for * to match, found none")
    return [found.removesuffix(".") + equals + value for found in keys]


def _names_at(tree: dict[str, Any], path: str) -> list[str]:
    for part in path.split(".")[:-1]:
        nested = tree.get(part)
        tree = nested if isinstance(nested, dict) else {}
    return list(tree)
