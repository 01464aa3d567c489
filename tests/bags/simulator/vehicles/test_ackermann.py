import math
from dataclasses import replace

import numpy as np
import pytest

from lidcam.bags.simulator.vehicles.ackermann import HABITS, Ackermann, AckermannCommand, chassis_of
from lidcam.bags.simulator.world.bodies.dimensions import Shape
from lidcam.bags.simulator.world.motion import State

SHAPE = Shape("car", (4.5, 1.9, 1.5), (1.3, 0.0, 0.75), None, 2.7, 1.5, 0.3, 0.6)
CAR = Ackermann(SHAPE, replace(HABITS["car"], acceleration_m_s2=1.0, hard_braking_m_s2=6.0, steering_rate_rad_s=0.8))
REST = State(0.0, 0.0, 0.0)


def driven(start: State, command: AckermannCommand, seconds: float, step_s: float = 0.01) -> list[State]:
    states = [start]
    for _ in range(round(seconds / step_s)):
        states.append(CAR.step(states[-1], command, step_s))
    return states


@pytest.mark.parametrize("step_s", [0.001, 1.0])
def test_an_arc_is_exact_whatever_the_step(step_s: float) -> None:
    end = driven(State(0.0, 0.0, 0.0, 3.0, 0.4), AckermannCommand(3.0, 0.4), 10, step_s)[-1]
    radius, angle = SHAPE.wheel_base_m / math.tan(0.4), 30 * math.tan(0.4) / SHAPE.wheel_base_m
    assert (end.x_m, end.y_m, end.yaw_rad, end.walked_m) == pytest.approx(
        (radius * math.sin(angle), radius * (1 - math.cos(angle)), angle, 30.0), abs=1e-9
    )


def test_commands_take_effect_as_fast_as_the_chassis_can() -> None:
    states = driven(REST, AckermannCommand(1.0, 0.4), 1)
    speeds, steerings = [s.speed_m_s for s in states], [s.steering_rad for s in states]
    np.testing.assert_allclose(speeds[:51], np.arange(51) * 0.02, atol=1e-9)
    np.testing.assert_allclose(steerings[:51], np.arange(51) * 0.008, atol=1e-9)
    assert speeds[-1] == 1.0
    assert steerings[-1] == 0.4


@pytest.mark.parametrize(("steering", "inner", "outer"), [(0.49, "left", "right"), (-0.49, "right", "left")])
def test_the_inner_wheel_turns_further(steering: float, inner: str, outer: str) -> None:
    chassis = chassis_of("model_car")
    assert chassis is not None
    commands = chassis.controllers(AckermannCommand(0.3, steering))
    assert commands[:4] == pytest.approx((8.4,) * 4)  # speed x 28, as in the predecessor system
    base_m, track_m = chassis.shape.wheel_base_m, chassis.shape.track_width_m
    radius = base_m / math.tan(0.49)
    angles = {"left": commands[4], "right": commands[5]}
    # Square to the centre of the turn, which lies on the line of the rear axle.
    assert abs(angles[inner]) == pytest.approx(math.atan2(base_m, radius - track_m / 2))
    assert abs(angles[outer]) == pytest.approx(math.atan2(base_m, radius + track_m / 2))
    assert np.sign(angles["left"]) == np.sign(angles["right"]) == np.sign(steering)
