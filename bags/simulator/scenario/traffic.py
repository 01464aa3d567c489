"""Settings of vehicles, cyclists, pedestrians and their routes, and the topics through which a car is driven."""

from typing import Annotated, Literal

from pydantic import Field

from lidcam.bags.simulator.scenario.sensors import Metres
from lidcam.pipeline.core.settings.model import NotNegative, Positive, SettingsModel, Share

CarBody = Literal["hatchback", "saloon", "estate", "mpv"]
Posture = Literal["upright", "sitting", "stooping", "reaching"]
Scale = Annotated[float, Field(ge=0.3, le=3)]

CONTROLLERS = (
    "left_rear_wheel_velocity_controller",
    "right_rear_wheel_velocity_controller",
    "left_front_wheel_velocity_controller",
    "right_front_wheel_velocity_controller",
    "left_steering_hinge_position_controller",
    "right_steering_hinge_position_controller",
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
