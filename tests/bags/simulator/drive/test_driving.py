"""Keys and what they do; through a pseudo-terminal they are read as pressed, and the terminal is as it was before."""

import os
import pty
import signal
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from lidcam.bags.simulator.drive.driving import RemoteControl, terminal_keys
from lidcam.bags.simulator.vehicles.ackermann import KEY_COMMANDS, AckermannCommand, commands_of_keys

FORWARD, STOP = AckermannCommand(0.3, 0.0), AckermannCommand(0.0, 0.0)
Terminal = tuple[int, int]  # the user's end, and the program's end


def test_keys_are_those_of_the_predecessor_system() -> None:
    found = {key: (one.speed_m_s, one.steering_rad) for key, one in KEY_COMMANDS.items()}
    assert found == {
        **{"w": (0.3, 0.0), "s": (-0.3, 0.0), "x": (0.0, 0.0)},
        **{"a": (0.3, pytest.approx(0.49)), "d": (0.3, pytest.approx(-0.49))},
    }


@pytest.mark.parametrize(
    ("keys", "expected"),
    [("", []), ("w..x", [(0, FORWARD), (1_500_000_000, STOP)]), ("woa", [(0, FORWARD)]), ("o", [])],
)
def test_scripts(keys: str, expected: list[tuple[int, AckermannCommand]]) -> None:
    assert commands_of_keys(keys, 0.5) == expected


@pytest.mark.parametrize(
    ("keys", "chosen", "commands"),
    [
        ("w?2x1", "car1", {"car1": FORWARD, "car2": STOP}),
        ("w2w30", "car2", {"car1": FORWARD, "car2": FORWARD}),
        ("", "car1", {}),
    ],
)
def test_a_command_holds_until_the_next_one_to_the_same_car(
    keys: str, chosen: str, commands: dict[str, AckermannCommand]
) -> None:
    control = RemoteControl(("car1", "car2"), "car1")
    for key in keys:
        control = control.pressed(key)
    assert (control.chosen, control.commands, control.done) == (chosen, commands, False)
    assert control.pressed("o").done


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    user, program = pty.openpty()
    yield user, program
    for descriptor in (user, program):
        with suppress(OSError):
            os.close(descriptor)


def test_a_lost_terminal_ends_the_input(terminal: Terminal) -> None:
    user, program = terminal
    with terminal_keys(program) as keys:
        os.close(user)
        assert keys.pressed(0).ended


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_repeated_signals_end_the_input(terminal: Terminal, number: signal.Signals) -> None:
    """A closed terminal is signalled by the kernel and by the shell; Ctrl-C twice wants the recording, too."""
    with terminal_keys(terminal[1]) as keys:
        for _ in range(3):
            os.kill(os.getpid(), number)
        assert keys.pressed(0).ended


def test_simulated_time_does_not_run_ahead(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, waits = [100.0], []

    def select_later(*arguments: Any) -> tuple[list[int], list[int], list[int]]:
        """The terminal answers after half of each wait."""
        waits.append(round(arguments[3], 3))
        now_s[0] += arguments[3] / 2 if len(waits) < 3 else arguments[3]
        return [], [], []

    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    with terminal_keys(terminal[1]) as keys, monkeypatch.context() as patched:
        patched.setattr("select.select", select_later)
        keys.wait(200_000_000)
        assert waits == [0.2, 0.1, 0.05]
        keys.wait(100_000_000)  # already past
        assert len(waits) == 3
