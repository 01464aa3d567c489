"""How a car with steered front wheels moves, and the six controllers through which the original drives it.

The kinematic bicycle model with the rear axle as its reference: wheels roll and do not slip, so that the middle of the
rear axle goes round a circle of radius wheel base / tan(steering) (Rajamani, Vehicle Dynamics and Control, 2012, 2.2).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from bags.simulator.vehicles.trajectory import State

__all__ = ["Ackermann", "AckermannCommand", "ControllerCommands"]


@dataclass(frozen=True, slots=True)
class AckermannCommand:
    """What a driver asks for (ackermann_msgs/AckermannDrive).

    Attributes:
        speed_m_s: Along the heading; negative backwards.
        steering_rad: Of the middle of the front axle, to the left.
    """

    speed_m_s: float = 0.0
    steering_rad: float = 0.0


class ControllerCommands(NamedTuple):
    """What the six controllers of a car are told.

    Attributes:
        left_rear_rad_s: Rate of a wheel.
        right_rear_rad_s: As above.
        left_front_rad_s: As above.
        right_front_rad_s: As above.
        left_hinge_rad: Angle of a front wheel, to the left.
        right_hinge_rad: As above.
    """

    left_rear_rad_s: float
    right_rear_rad_s: float
    left_front_rad_s: float
    right_front_rad_s: float
    left_hinge_rad: float
    right_hinge_rad: float


@dataclass(frozen=True, slots=True)
class Ackermann:
    """A car's chassis.

    Attributes:
        wheel_base_m: From the rear axle to the front one.
        track_m: From the left front wheel to the right one; 0 for a two-wheeler.
        wheel_radius_m: Of all wheels.
        max_steering_rad: Either way, of the middle of the front axle.
        steering_rate_rad_s: How fast the steering turns.
        acceleration_m_s2: How fast the speed rises.
        braking_m_s2: How fast it falls.
    """

    wheel_base_m: float
    track_m: float
    wheel_radius_m: float
    max_steering_rad: float
    steering_rate_rad_s: float
    acceleration_m_s2: float
    braking_m_s2: float

    def controllers(self, command: AckermannCommand) -> ControllerCommands:
        """What a command makes of the controllers.

        All wheels get the same rate, as in the original: speed x 28 for its cars, whose wheels' radius is 1/28 m. The
        hinges get the angles at which both front wheels stand square to the centre of the turn, the inner one more than
        the outer one; the original gave both the same angle, at which one of them slips.
        """
        rate = command.speed_m_s / self.wheel_radius_m
        slope = math.tan(self._within_limits(command.steering_rad))
        lean = slope * self.track_m / (2 * self.wheel_base_m)
        left, right = math.atan(slope / (1 - lean)), math.atan(slope / (1 + lean))
        return ControllerCommands(rate, rate, rate, rate, left, right)

    def command(self, controllers: ControllerCommands) -> AckermannCommand:
        """What the controllers' commands make the car do.

        The rear wheels drive it, at the mean of their rates. It turns about the point halfway between those about which
        the two front wheels would have it turn.
        """
        rate = (controllers.left_rear_rad_s + controllers.right_rear_rad_s) / 2
        left, right = math.tan(controllers.left_hinge_rad), math.tan(controllers.right_hinge_rad)
        both = left + right
        slope = 2 * left * right / both if both else 0.0
        return AckermannCommand(rate * self.wheel_radius_m, self._within_limits(math.atan(slope)))

    def step(self, state: State, command: AckermannCommand, seconds: float) -> State:
        """The state after a time in which a command was in force.

        Speed and steering approach the command as fast as the chassis can. The way is an arc whose curvature is that of
        the mean steering: no error of integration grows while the steering is held.
        """
        speed = state.speed_m_s + self._change_of_speed(state.speed_m_s, command.speed_m_s, seconds)
        turned = self.steering_rate_rad_s * seconds
        change = self._within_limits(command.steering_rad) - state.steering_rad
        steering = state.steering_rad + min(max(change, -turned), turned)
        way = (state.speed_m_s + speed) / 2 * seconds
        turn = way * math.tan((state.steering_rad + steering) / 2) / self.wheel_base_m
        # The chord of the arc, and its direction.
        chord = way * (math.sin(turn / 2) / (turn / 2) if turn else 1.0)
        towards = state.yaw_rad + turn / 2
        return State(
            x_m=state.x_m + chord * math.cos(towards),
            y_m=state.y_m + chord * math.sin(towards),
            yaw_rad=state.yaw_rad + turn,
            speed_m_s=speed,
            steering_rad=steering,
            walked_m=state.walked_m + way,
        )

    def _change_of_speed(self, speed: float, wanted: float, seconds: float) -> float:
        # Whoever turns back brakes first: a step ends at rest at most.
        if speed and (wanted - speed) * speed < 0:
            goal = wanted if wanted * speed > 0 else 0.0
            most = self.braking_m_s2 * seconds
        else:
            goal, most = wanted, self.acceleration_m_s2 * seconds
        return min(max(goal - speed, -most), most)

    def _within_limits(self, steering_rad: float) -> float:
        return min(max(steering_rad, -self.max_steering_rad), self.max_steering_rad)
