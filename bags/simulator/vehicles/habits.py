"""Driving habits and chassis by shape."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from lidcam.bags.simulator.vehicles.ackermann import Ackermann
from lidcam.bags.simulator.world.bodies.dimensions import shape_of


@dataclass(frozen=True, slots=True)
class Habits:
    """The driving habits of a driver or pedestrian.

    Attributes:
        acceleration_m_s2: Comfortable acceleration.
        braking_m_s2: Comfortable braking.
        hard_braking_m_s2: Emergency braking.
        sideways_m_s2: Lateral acceleration in curves.
        headway_s: Time gap to the vehicle ahead.
        gap_m: Gap to the vehicle ahead at rest.
        clearance_m: Free room wanted on each side.
        look_ahead_m: Distance from the rear axle to the route point to steer for, at rest.
        look_ahead_s: Increase of that distance per m/s.
        steering_rate_rad_s: Steering rate.
    """

    acceleration_m_s2: float
    braking_m_s2: float
    hard_braking_m_s2: float
    sideways_m_s2: float
    headway_s: float
    gap_m: float
    clearance_m: float
    look_ahead_m: float
    look_ahead_s: float
    steering_rate_rad_s: float


HABITS: Mapping[str, Habits] = MappingProxyType(
    {
        "model_car": Habits(0.5, 0.5, 1.5, 0.5, 0.5, 0.08, 0.02, 0.16, 0.1, 4.0),
        "car": Habits(1.8, 2.2, 8.0, 2.0, 1.2, 1.5, 0.25, 2.6, 0.35, 0.9),
        "van": Habits(1.5, 2.0, 7.0, 1.8, 1.3, 1.7, 0.25, 3.2, 0.35, 0.8),
        "truck": Habits(1.1, 1.8, 6.0, 1.4, 1.5, 2.0, 0.3, 4.2, 0.35, 0.7),
        "bus": Habits(1.1, 1.5, 6.0, 1.3, 1.5, 2.0, 0.3, 5.0, 0.35, 0.7),
        "cyclist": Habits(1.0, 1.8, 5.0, 1.8, 1.0, 0.8, 0.15, 1.0, 0.35, 2.0),
        "pedestrian": Habits(1.0, 1.5, 3.0, 5.0, 0.5, 0.3, 0.0, 0.0, 0.0, 0.0),
    }
)
"""Habits by shape."""


def chassis_of(shape: str, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Ackermann | None:
    """The chassis of a shape, its length, width and height times a scale; None for a pedestrian."""
    facts, habits = shape_of(shape, scale), HABITS[shape]
    if not facts.wheel_base_m:
        return None
    return Ackermann(
        wheel_base_m=facts.wheel_base_m,
        track_m=facts.track_width_m,
        wheel_radius_m=facts.wheel_radius_m,
        max_steering_rad=facts.max_steering_rad,
        steering_rate_rad_s=habits.steering_rate_rad_s,
        acceleration_m_s2=2 * habits.acceleration_m_s2,
        braking_m_s2=habits.hard_braking_m_s2,
    )
