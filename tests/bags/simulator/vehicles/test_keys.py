import pytest
from lidcam.bags.simulator.vehicles.keys import RemoteControl, command_of, commands_of_keys

from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand

FORWARD, LEFT, STOP = AckermannCommand(0.3, 0.0), AckermannCommand(0.3, 0.49), AckermannCommand(0.0, 0.0)


@pytest.mark.parametrize(
    ("key", "speed", "steering"),
    [("w", 0.3, 0.0), ("s", -0.3, 0.0), ("a", 0.3, 0.49), ("d", 0.3, -0.49), ("x", 0.0, 0.0)],
)
def test_keys_are_the_originals(key: str, speed: float, steering: float) -> None:
    command = command_of(key)
    assert command is not None
    assert (command.speed_m_s, command.steering_rad) == pytest.approx((speed, steering))


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("", []),
        ("w", [(0, FORWARD)]),
        ("w..x", [(0, FORWARD), (1_500_000_000, STOP)]),
        ("woa", [(0, FORWARD)]),
        ("o", []),
    ],
)
def test_scripts(keys: str, expected: list[tuple[int, AckermannCommand]]) -> None:
    assert commands_of_keys(keys, 0.5) == expected


def pressed(keys: str, *vehicles: str) -> RemoteControl:
    control = RemoteControl.of(vehicles)
    for key in keys:
        control = control.pressed(key)
    return control


def test_a_command_holds_until_the_next_one_to_the_same_car() -> None:
    control = pressed("w?2a1", "car1", "car2")
    assert control.chosen == "car1"
    assert control.commands["car1"] == FORWARD
    assert control.commands["car2"].steering_rad == pytest.approx(0.49)
    assert not control.done


@pytest.mark.parametrize("keys", ["3", "0", "9", ""])
def test_a_car_that_is_not_there_is_not_chosen(keys: str) -> None:
    assert pressed(f"2{keys}", "car1", "car2").chosen == "car2"
