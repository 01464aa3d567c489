"""Scenarios: what a simulated recording is made of, as YAML that people copy and change.

Every model refuses unknown keys. Units stand in the names. Frames: the world's is the site's (x forward, y left, z up);
a sensor that is mounted on a vehicle has its place in the vehicle's base frame (on the ground below the rear axle).
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from scipy.spatial.transform import Rotation

from bags.simulator.topics import command_topic, controller_topics
from pipeline.core.config import describe_validation, read_yaml, set_values
from pipeline.core.errors import ConfigError
from pipeline.core.geometry import Transform

__all__ = [
    "CameraScenario",
    "Detector2DScenario",
    "LidarScenario",
    "Miscalibration",
    "RecordingScenario",
    "RouteScenario",
    "Scenario",
    "SensorScenario",
    "VehicleScenario",
    "load_scenario",
    "scenario_names",
]

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
EGO_FRAME = "base_link"
"""Of the vehicle that carries sensors (REP 105)."""
OWN_TOPICS = ("/tf", "/tf_static", "/odom", "/ground_truth/objects")
COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
"""Of the distortion models, as CameraInfo has them."""
Count = Annotated[int, Field(ge=1)]
Metres = Annotated[float, Field(ge=-1e5, le=1e5)]
"""Of places: further out, single precision knows no millimetres."""
Vector = tuple[Finite, Finite, Finite]
Topic = Annotated[str, Field(pattern=r"^/[A-Za-z_]\w*(/\w+)*$")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Miscalibration(_Model):
    """By how much the recorded extrinsics of a sensor are wrong.

    Attributes:
        rpy_deg: Roll, pitch, yaw in the frame of the sensor's body (x forward, y left, z up).
        xyz_cm: Shift in that frame.
    """

    rpy_deg: Vector = (0.0, 0.0, 0.0)
    xyz_cm: Vector = (0.0, 0.0, 0.0)


class SensorScenario(_Model):
    """What every sensor has: a place, a clock, and faults.

    Attributes:
        topic: Of its measurements.
        frame_id: In its messages and in tf.
        mounted_on: Name of a vehicle; empty: fixed to the site.
        position_m: Its place.
        rpy_deg: Roll, pitch, yaw (about fixed x, y, z) of its body: x forward, y left, z up. A camera looks along x.
        rate_hz: Measurements per second.
        phase_ms: The first measurement begins this long after the scenario.
        jitter_ms: Standard deviation of the moment of measurement.
        clock_offset_ms: Its clock runs ahead of the true time by this: stamps are wrong by it.
        drop_rate: Share of its messages that are lost.
        log_delay_ms: A message is recorded this long after its measurement ended; a picture, after its stamp.
        log_jitter_ms: Standard deviation of that delay (never negative); large ones let messages overtake each other.
        dies_at_s: No measurement begins at or after this time of the scenario.
        miscalibration: What is wrong with its recorded extrinsics.
    """

    topic: Topic
    frame_id: str
    mounted_on: str = ""
    position_m: tuple[Metres, Metres, Metres]
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    rate_hz: Positive = 10.0
    phase_ms: NotNegative = 0.0
    jitter_ms: NotNegative = 0.0
    clock_offset_ms: Finite = 0.0
    drop_rate: Share = 0.0
    log_delay_ms: NotNegative = 5.0
    log_jitter_ms: NotNegative = 0.0
    dies_at_s: NotNegative | None = None
    miscalibration: Miscalibration = Miscalibration()

    def T_carrier_body(self, carrier_frame: str) -> Transform:
        """The true place of the sensor's body (x forward) on what carries it."""
        turn = Rotation.from_euler("xyz", self.rpy_deg, degrees=True)
        return Transform.from_quaternion(carrier_frame, self.frame_id, self.position_m, turn.as_quat())


class LidarScenario(SensorScenario):
    """A lidar that turns.

    Attributes:
        model: A Velodyne model of `readers.velodyne.models`, or `linear`: evenly spread beams.
        beams: Number of beams of a `linear` lidar.
        elevation_deg: Lowest and highest beam of a `linear` lidar.
        columns: Firings per turn of a `linear` lidar; the other models fire at their own pace.
        firing_stride: Only every n-th firing is recorded, for small files (points only).
        start_azimuth_deg: Where a sweep begins, clockwise from the front.
        output: `points` (PointCloud2 on `topic`), `packets` (velodyne_msgs/VelodyneScan on `packets_topic`) or `both`.
        packets_topic: Topic of the packets.
        return_mode: Which echoes are recorded where a beam meets an edge.
        divergence_mrad: Full angle of a beam.
        echo_separation_m: Two surfaces in one beam make two echoes if they are further apart than this.
        min_range_m: Nothing nearer is measured.
        max_range_m: A white surface is seen this far; darker ones less far.
        range_noise_m: Standard deviation.
        dropout: Share of the echoes that are lost for no reason.
    """

    model: Literal["VLP-16", "Puck Hi-Res", "HDL-32E", "VLP-32A", "VLP-32B", "VLP-32C", "linear"] = "VLP-16"
    beams: Count = 64
    elevation_deg: tuple[Finite, Finite] = (-25.0, 3.0)
    columns: Count = 1800
    firing_stride: Count = 1
    start_azimuth_deg: Finite = 180.0
    output: Literal["points", "packets", "both"] = "points"
    packets_topic: Topic | Literal[""] = ""
    return_mode: Literal["strongest", "last", "dual"] = "strongest"
    divergence_mrad: NotNegative = 3.0
    echo_separation_m: Positive = 0.5
    min_range_m: NotNegative = 0.1
    max_range_m: Positive = 100.0
    range_noise_m: NotNegative = 0.01
    dropout: Share = 0.005

    @property
    def topics(self) -> list[str]:
        """Where its messages are."""
        both = {"points": [self.topic], "packets": [self.packets_topic], "both": [self.topic, self.packets_topic]}
        return both[self.output]


class Detector2DScenario(_Model):
    """A 2D detector that errs, instead of a network.

    Attributes:
        topic: Of its vision_msgs/Detection2DArray.
        delay_ms: Recorded this long after the image.
        pixel_noise_px: Standard deviation of each edge.
        miss_rate: Share of the visible things that it misses.
        false_per_image: False boxes per image on average.
        min_visible: A thing of which less than this share is visible is not found.
        min_height_px: Neither is one whose box is lower than this.
    """

    topic: Topic
    delay_ms: NotNegative = 30.0
    pixel_noise_px: NotNegative = 1.2
    miss_rate: Share = 0.05
    false_per_image: NotNegative = 0.05
    min_visible: Share = 0.3
    min_height_px: NotNegative = 12.0


class CameraScenario(SensorScenario):
    """A camera; the frame of its messages is the optical one (z forward, x right, y down).

    Attributes:
        info_topic: Of its sensor_msgs/CameraInfo.
        width_px: Columns.
        height_px: Rows.
        focal_px: fx and fy.
        center_px: cx and cy; empty: the middle of the picture.
        distortion_model: As in CameraInfo.
        distortion: Coefficients in its order; what is left out is 0.
        exposure_ms: Light is gathered this long; the stamp is the middle.
        motion_blur: Whether what moves is blurred by the exposure.
        gain: Brightness.
        noise: Standard deviation of a pixel's value, of 255.
        output: `jpeg` (CompressedImage on `topic`/compressed) or `raw` (Image on `topic`, rgb8).
        jpeg_quality: 1 to 100.
        detector: A simulated detector that looks at it.
    """

    info_topic: Topic
    width_px: Count = 640
    height_px: Count = 480
    focal_px: tuple[Positive, Positive]
    center_px: tuple[Finite, Finite] | None = None
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = "plumb_bob"
    distortion: tuple[Finite, ...] = ()
    exposure_ms: NotNegative = 4.0
    motion_blur: bool = False
    gain: Positive = 1.0
    noise: NotNegative = 1.0
    output: Literal["jpeg", "raw"] = "jpeg"
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 80
    detector: Detector2DScenario | None = None

    @property
    def picture_topic(self) -> str:
        """Where its pictures are."""
        return f"{self.topic}/compressed" if self.output == "jpeg" else self.topic

    @property
    def topics(self) -> list[str]:
        """Where its messages are."""
        return [self.picture_topic, self.info_topic, *([self.detector.topic] if self.detector else [])]

    @property
    def coefficients(self) -> tuple[float, ...]:
        """All of the distortion model's."""
        return (*self.distortion, *[0.0] * (COEFFICIENTS[self.distortion_model] - len(self.distortion)))


class RouteScenario(_Model):
    """A way over the ground that traffic follows.

    Attributes:
        points_m: Corners x, y; they are rounded off. A third number is the radius of that corner alone.
        closed: Whether the last point leads to the first.
        corner_radius_m: How much corners are rounded off.
        yields_to: Routes whose traffic goes first where the two cross.
    """

    points_m: tuple[tuple[Metres, Metres] | tuple[Metres, Metres, NotNegative], ...]
    closed: bool = False
    corner_radius_m: NotNegative = 5.0
    yields_to: tuple[str, ...] = ()


class VehicleScenario(_Model):
    """Something that moves: who drives it, where from, how fast.

    Attributes:
        shape: What it looks like (`bags.simulator.recorder.movers`).
        color: Its paint, each in [0, 1].
        start: x, y in metres, and yaw in degrees of its base frame (below the rear axle, or below the middle of one
            that has none); on a route it counts only where somebody takes over (`lidcam drive`).
        route: Name of a route; it drives along it by itself.
        route_start_m: Where on the route it begins.
        speed_m_s: How fast, on a route.
        keys: Keys that drive it instead (`w s a d x`), `key_interval_s` each, from the start.
        key_interval_s: Time from one key to the next.
        odometry: Record nav_msgs/Odometry: the true pose of the middle of its box on /NAME/base_pose_ground_truth; that
            of `base_link` on /odom, if it is the ego vehicle.
        commands: Record its ackermann_msgs/AckermannDriveStamped and the six Float64 commands of its controllers.
        ego: It carries sensors and is the frame that tf leads to (`odom` to `base_link`); it is no object of the truth.
    """

    shape: Literal["model_car", "car", "van", "truck", "bus", "cyclist", "pedestrian"] = "car"
    color: tuple[Share, Share, Share] = (0.6, 0.1, 0.1)
    start: tuple[Metres, Metres, Finite] = (0.0, 0.0, 0.0)
    route: str = ""
    route_start_m: NotNegative = 0.0
    speed_m_s: NotNegative = 0.0
    keys: str = ""
    key_interval_s: Positive = 0.5
    odometry: bool = False
    commands: bool = False
    ego: bool = False

    def topics(self, name: str) -> list[str]:
        """Where its messages are, under its name."""
        odometry = [f"/{name}/base_pose_ground_truth"] if self.odometry and not self.ego else []
        return [*odometry, *([command_topic(name), *controller_topics(name)] if self.commands else [])]


class RecordingScenario(_Model):
    """What is recorded beside the sensors, and how.

    Attributes:
        truth_rate_hz: Of /ground_truth/objects; 0 records none.
        odometry_rate_hz: Of the vehicles' odometry and tf.
        command_rate_hz: Of the vehicles' commands.
    """

    truth_rate_hz: NotNegative = 10.0
    odometry_rate_hz: Positive = 50.0
    command_rate_hz: Positive = 20.0


class SunScenario(_Model):
    """Where the light comes from.

    Attributes:
        azimuth_deg: Counter-clockwise from +x.
        elevation_deg: Above the ground.
        shadows: Whether it casts shadows.
    """

    azimuth_deg: Finite = -50.0
    elevation_deg: Annotated[float, Field(gt=0, le=90)] = 50.0
    shadows: bool = True


class Scenario(_Model):
    """A whole scenario.

    Attributes:
        description: One line for people.
        world: What stands still.
        site_frame: Frame of the world in the messages.
        start_unix_s: Time of the first moment, seconds since 1970; a header counts to 2038.
        duration_s: Length of the recording, if nothing else is asked for.
        seed: Of all random numbers.
        sun: Light.
        routes: Ways for traffic, by name.
        vehicles: What moves, by name.
        lidars: By name.
        cameras: By name.
        recording: What else is recorded.
    """

    description: str = ""
    world: Literal["sandbox", "crossing", "street"]
    site_frame: str = "site"
    start_unix_s: Annotated[int, Field(ge=0, le=2_000_000_000)] = 1_700_000_000
    duration_s: Positive = 10.0
    seed: Annotated[int, Field(ge=0)] = 1
    sun: SunScenario = SunScenario()
    routes: dict[str, RouteScenario] = {}
    vehicles: dict[Name, VehicleScenario] = {}
    lidars: dict[Name, LidarScenario] = {}
    cameras: dict[Name, CameraScenario] = {}
    recording: RecordingScenario = RecordingScenario()

    @model_validator(mode="after")
    def _names_lead_somewhere(self) -> "Scenario":
        for name, vehicle in self.vehicles.items():
            if vehicle.route and vehicle.route not in self.routes:
                raise ValueError(
                    f"vehicles.{name}.route: expected one of {_listed(self.routes)}, found {vehicle.route!r}"
                )
            if vehicle.route and vehicle.keys:
                raise ValueError(f"vehicles.{name}: expected a route or keys, found both")
            if vehicle.shape == "pedestrian" and (vehicle.commands or vehicle.keys or vehicle.ego):
                raise ValueError(f"vehicles.{name}: expected a route for a pedestrian, whom nobody drives")
        for name, route in self.routes.items():
            for other in route.yields_to:
                if other not in self.routes:
                    raise ValueError(
                        f"routes.{name}.yields_to: expected one of {_listed(self.routes)}, found {other!r}"
                    )
        egos = [name for name, vehicle in self.vehicles.items() if vehicle.ego]
        if len(egos) > 1:
            raise ValueError(f"vehicles: expected one ego at most, found {_listed(egos)}")
        return self

    @model_validator(mode="after")
    def _sensors_fit(self) -> "Scenario":
        for name, sensor in self.sensors.items():
            if sensor.mounted_on not in ("", self.ego):
                raise ValueError(f"{name}.mounted_on: expected the ego vehicle or nothing, found {sensor.mounted_on!r}")
        for name, lidar in ((f"lidars.{key}", value) for key, value in self.lidars.items()):
            if lidar.output != "points" and (lidar.model == "linear" or not lidar.packets_topic):
                raise ValueError(f"{name}: packets need a Velodyne model and a packets_topic")
            if lidar.output != "points" and lidar.firing_stride != 1:
                raise ValueError(f"{name}: packets hold every firing: expected firing_stride 1")
            if lidar.elevation_deg[0] >= lidar.elevation_deg[1]:
                raise ValueError(f"{name}.elevation_deg: expected the lower one first, found {lidar.elevation_deg}")
            of_linear = {key: LidarScenario.model_fields[key].default for key in ("beams", "elevation_deg", "columns")}
            for key, default in of_linear.items():
                if lidar.model != "linear" and getattr(lidar, key) != default:
                    raise ValueError(f"{name}.{key}: is for the model `linear`; a {lidar.model} has its own")
        for name, camera in ((f"cameras.{key}", value) for key, value in self.cameras.items()):
            if len(camera.distortion) > COEFFICIENTS[camera.distortion_model]:
                most = f"{camera.distortion_model} has {COEFFICIENTS[camera.distortion_model]} coefficients"
                raise ValueError(f"{name}.distortion: {most}, found {len(camera.distortion)}")
        return self

    @model_validator(mode="after")
    def _names_are_unique(self) -> "Scenario":
        topics = [("the simulator", topic) for topic in OWN_TOPICS]
        topics += [(name, topic) for name, sensor in self.sensors.items() for topic in sensor.topics]
        topics += [(name, topic) for name, vehicle in self.vehicles.items() for topic in vehicle.topics(name)]
        frames = [("the simulator", frame) for frame in (self.site_frame, EGO_FRAME, *self.vehicles)]
        frames += [(name, sensor.frame_id) for name, sensor in self.sensors.items()]
        for kind, used in (("topic", topics), ("frame", frames)):
            owner: dict[str, str] = {}
            for name, word in used:
                if word in owner and (kind == "topic" or owner[word] != name):
                    raise ValueError(f"{name}: {word!r} is a {kind} of {owner[word]}, too")
                owner[word] = name
        return self

    @property
    def sensors(self) -> dict[str, LidarScenario | CameraScenario]:
        """Lidars, then cameras, by the name that messages about them give: `lidars.top`."""
        lidars = {f"lidars.{name}": lidar for name, lidar in self.lidars.items()}
        return {**lidars, **{f"cameras.{name}": camera for name, camera in self.cameras.items()}}

    @property
    def ego(self) -> str:
        """Name of the vehicle that carries the sensors; empty where these are fixed to the site."""
        return next((name for name, vehicle in self.vehicles.items() if vehicle.ego), "")

    @property
    def start_ns(self) -> int:
        """Time of the first moment."""
        return self.start_unix_s * 10**9


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def scenario_names() -> list[str]:
    """The scenarios that come with lidcam."""
    return sorted(path.stem for path in _folder().glob("*.yaml"))


def load_scenario(name: str, overrides: tuple[str, ...] = ()) -> Scenario:
    """A scenario by its name or by the path of a YAML file, then single values `a.b=value`.

    `*` in place of a name stands for all of them: `cameras.*.rate_hz=5`.

    Raises:
        ConfigError: there is none of this name, the file cannot be read, a key is unknown, or a value does not fit.
    """
    path = Path(name)
    if path.suffix not in {".yaml", ".yml"}:
        path = _folder() / f"{name}.yaml"
        if not path.is_file():
            raise ConfigError(f"{name}: expected a YAML file or one of {_listed(scenario_names())}")
    tree = read_yaml(path)
    set_values(tree, tuple(override for given in overrides for override in _for_each(tree, given)))
    try:
        return Scenario.model_validate(tree)
    except ValidationError as err:
        where = f"{path} with --set" if overrides else f"{path}"
        raise ConfigError(f"{where}: {describe_validation(Scenario, err)}") from err


def _for_each(tree: dict[str, Any], override: str) -> list[str]:
    """An override for each of the names that a `*` in its key stands for."""
    key, equals, value = override.partition("=")
    if key.startswith("*"):
        raise ConfigError(f"--set {override}: name the section, as in cameras.*.rate_hz")
    keys = [""]
    for part in key.split("."):
        keys = [f"{before}{name}." for before in keys for name in (_names_at(tree, before) if part == "*" else [part])]
    if not keys:
        raise ConfigError(f"--set {override}: * stands for nothing there")
    return [found.removesuffix(".") + equals + value for found in keys]


def _names_at(tree: dict[str, Any], path: str) -> list[str]:
    for part in path.split(".")[:-1]:
        nested = tree.get(part)
        tree = nested if isinstance(nested, dict) else {}
    return list(tree)


def _folder() -> Path:
    """Of the scenarios: inside the package where it is installed, in `config/` where it is worked on."""
    package = Path(__file__).parents[1]
    installed = package / "scenarios"
    return installed if installed.is_dir() else package.parent / "config" / "scenarios"
