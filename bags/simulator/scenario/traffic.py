"""Vehicles and people of a scenario, and their ways."""

from typing import Literal

from bags.simulator.scenario.model import Metres
from bags.simulator.topics import command_topic, controller_topics
from pipeline.core.settings.model import NotNegative, Positive, SettingsModel, Share

__all__ = ["RouteScenario", "VehicleScenario"]


class RouteScenario(SettingsModel):
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


class VehicleScenario(SettingsModel):
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
    start: tuple[Metres, Metres, float] = (0.0, 0.0, 0.0)
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
