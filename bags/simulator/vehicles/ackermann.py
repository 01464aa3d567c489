"""The motion of a car with steered front wheels, and the six wheel and hinge controllers of the predecessor system.

The kinematic bicycle model with the rear axle as reference: wheels roll without slip, so the middle of the rear axle
follows a circle of radius wheel base / tan(steering) (Rajamani, Vehicle Dynamics and Control, 2012, 2.2).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from lidcam.bags.simulator.world.bodies.dimensions import Shape, Vector, shape_of
from lidcam.bags.simulator.world.motion import State


@dataclass(frozen=True, slots=True)
class AckermannCommand:
    """Target speed and steering (ackermann_msgs/AckermannDrive)."""

    speed_m_s: float = 0.0  # along the heading; negative backwards
    steering_rad: float = 0.0  # at the middle of the front axle, positive to the left


KEY_COMMANDS: Mapping[str, AckermannCommand] = {
    "w": AckermannCommand(0.3, 0.0),
    "s": AckermannCommand(-0.3, 0.0),
    "a": AckermannCommand(0.3, 0.7 * 0.7),
    "d": AckermannCommand(0.3, -0.7 * 0.7),
    "x": AckermannCommand(0.0, 0.0),
}
"""Commands of the remote control of the predecessor system, by key."""
QUIT = "o"


def commands_of_keys(keys: str, interval_s: float) -> list[tuple[int, AckermannCommand]]:
    """Times in nanoseconds and commands of keys pressed at a fixed pace from time 0.

    A key without a command only waits; keys after the quit key are ignored.
    """
    pressed = enumerate(keys.partition(QUIT)[0])
    return [(round(number * interval_s * 1e9), KEY_COMMANDS[key]) for number, key in pressed if key in KEY_COMMANDS]


@dataclass(frozen=True, slots=True)
class Habits:
    """The driving habits of a driver or pedestrian."""

    acceleration_m_s2: float  # comfortable, as is the braking
    braking_m_s2: float
    hard_braking_m_s2: float
    sideways_m_s2: float  # lateral acceleration in curves
    headway_s: float  # time gap to the vehicle ahead
    gap_m: float  # gap to the vehicle ahead at rest
    clearance_m: float  # free room wanted on each side
    look_ahead_m: float  # from the rear axle to the route point to steer for, at rest
    look_ahead_s: float  # increase of that distance per m/s
    steering_rate_rad_s: float


HABITS: Mapping[str, Habits] = {
    "model_car": Habits(0.5, 0.5, 1.5, 0.5, 0.5, 0.08, 0.02, 0.16, 0.1, 4.0),
    "car": Habits(1.8, 2.2, 8.0, 2.0, 1.2, 1.5, 0.25, 2.6, 0.35, 0.9),
    "van": Habits(1.5, 2.0, 7.0, 1.8, 1.3, 1.7, 0.25, 3.2, 0.35, 0.8),
    "truck": Habits(1.1, 1.8, 6.0, 1.4, 1.5, 2.0, 0.3, 4.2, 0.35, 0.7),
    "bus": Habits(1.1, 1.5, 6.0, 1.3, 1.5, 2.0, 0.3, 5.0, 0.35, 0.7),
    "cyclist": Habits(1.0, 1.8, 5.0, 1.8, 1.0, 0.8, 0.15, 1.0, 0.35, 2.0),
    "pedestrian": Habits(1.0, 1.5, 3.0, 5.0, 0.5, 0.3, 0.0, 0.0, 0.0, 0.0),
}
"""By shape."""


@dataclass(frozen=True, slots=True)
class Ackermann:
    """A car's chassis; it can accelerate twice as hard as its driver does."""

    shape: Shape
    habits: Habits

    def controllers(self, command: AckermannCommand) -> tuple[float, ...]:
        """(6,) targets of `CONTROLLERS` for a command: wheel rates in rad/s, front wheel angles (positive to the left).

        All wheels get the same rate, as in the predecessor system: speed x 28 for model cars, whose wheel radius is
        1/28 m. The front wheels turn about a common centre, the inner one further than the outer one; the predecessor
        gave both the same angle, at which one of them slips.
        """
        rate = command.speed_m_s / self.shape.wheel_radius_m
        slope = math.tan(self._within_limits(command.steering_rad))
        lean = slope * self.shape.track_width_m / (2 * self.shape.wheel_base_m)
        left, right = math.atan(slope / (1 - lean)), math.atan(slope / (1 + lean))
        return *4 * [rate], left, right

    def step(self, state: State, command: AckermannCommand, seconds: float) -> State:
        """The state after following a command for a time.

        Speed and steering approach the command at the limits of the chassis. The path is an arc with the curvature of
        the mean steering, so constant steering adds no integration error.
        """
        speed = state.speed_m_s + self._change_of_speed(state.speed_m_s, command.speed_m_s, seconds)
        turned = self.habits.steering_rate_rad_s * seconds
        change = self._within_limits(command.steering_rad) - state.steering_rad
        steering = state.steering_rad + min(max(change, -turned), turned)
        way = (state.speed_m_s + speed) / 2 * seconds
        turn = way * math.tan((state.steering_rad + steering) / 2) / self.shape.wheel_base_m
        chord = way * (math.sin(turn / 2) / (turn / 2) if turn else 1.0)
        towards = state.yaw_rad + turn / 2
        x, y = state.x_m + chord * math.cos(towards), state.y_m + chord * math.sin(towards)
        return State(x, y, state.yaw_rad + turn, speed, steering, state.walked_m + way)

    def _change_of_speed(self, speed: float, wanted: float, seconds: float) -> float:
        # Brake to rest before reversing.
        if speed and (wanted - speed) * speed < 0:
            goal = wanted if wanted * speed > 0 else 0.0
            most = self.habits.hard_braking_m_s2 * seconds
        else:
            goal, most = wanted, 2 * self.habits.acceleration_m_s2 * seconds
        return min(max(goal - speed, -most), most)

    def _within_limits(self, steering_rad: float) -> float:
        return min(max(steering_rad, -self.shape.max_steering_rad), self.shape.max_steering_rad)


def chassis_of(shape: str, scale: Vector = (1.0, 1.0, 1.0)) -> Ackermann | None:
    """The chassis of a shape, its length, width and height times a scale; None for a pedestrian."""
    scaled = shape_of(shape, scale)
    return Ackermann(scaled, HABITS[shape]) if scaled.wheel_base_m else None
