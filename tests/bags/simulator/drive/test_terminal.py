"""Keys through a pseudo-terminal: read as pressed, and the terminal as it was before."""

import os
import pty
import select
import signal
import termios
from collections.abc import Iterator
from typing import Any

import pytest

from lidcam.bags.simulator.drive.driving import Pressed, TerminalKeys, terminal_keys
from lidcam.pipeline.core.ending import undo_all

Terminal = tuple[int, int]  # what a user's hand holds, and the program's end


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    hand, program = pty.openpty()
    yield hand, program
    for descriptor in (hand, program):
        try:
            os.close(descriptor)
        except OSError:
            continue


def read(keys: TerminalKeys, program: int, count: int) -> Pressed:
    """Read until so many keys have come: the system hands them over on its own time."""
    found = Pressed("", False)
    while len(found.keys) < count:
        select.select([program], [], [])
        more = keys.pressed(1)
        found = Pressed(found.keys + more.keys, more.ended)
    return found


def test_keys_come_without_enter_and_are_not_echoed(terminal: Terminal) -> None:
    hand, program = terminal
    with terminal_keys(program) as keys:
        assert keys.pressed(0) == ("", False)
        os.write(hand, b"wa")
        os.write(hand, b"d")
        assert read(keys, program, 3) == ("wad", False)
        assert keys.pressed(2) == ("", False)
        local = termios.tcgetattr(program)[3]
        assert not local & (termios.ECHO | termios.ICANON)


def test_the_terminal_is_restored_after_an_error(terminal: Terminal) -> None:
    _, program = terminal
    before = termios.tcgetattr(program)

    def fail() -> None:
        with terminal_keys(program):
            raise RuntimeError("anything")

    with pytest.raises(RuntimeError, match="anything"):
        fail()
    assert termios.tcgetattr(program) == before


def test_ctrl_d_ends_the_input(terminal: Terminal) -> None:
    hand, program = terminal
    with terminal_keys(program) as keys:
        os.write(hand, b"w\x04")
        found = read(keys, program, 2)
        assert found.ended
        assert found.keys.startswith("w")


def test_a_lost_terminal_ends_the_input() -> None:
    hand, program = pty.openpty()
    with terminal_keys(program) as keys:
        os.close(hand)
        assert keys.pressed(0).ended
    os.close(program)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_further_signals_change_nothing(terminal: Terminal, number: signal.Signals) -> None:
    """A closed terminal is told by the kernel and by the shell; Ctrl-C twice wants the recording, too."""
    _, program = terminal
    with terminal_keys(program) as keys:
        for _ in range(3):
            os.kill(os.getpid(), number)
        assert keys.pressed(0).ended


def test_a_stopped_terminal_does_not_hold_up_the_end(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    """After Ctrl-S what was printed is not written: a program that is told to end may not wait for that."""
    _, program = terminal
    before = termios.tcgetattr(program)
    asked: list[int] = []
    real = termios.tcsetattr

    def setting(descriptor: int, when: int, attributes: Any) -> None:
        asked.append(when)
        real(descriptor, when, attributes)

    with monkeypatch.context() as patched:
        patched.setattr(termios, "tcsetattr", setting)
        with terminal_keys(program):
            asked.clear()
            undo_all()
            assert asked == [termios.TCSANOW]
            assert termios.tcgetattr(program) == before


def test_simulated_time_does_not_run_ahead(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, waits = [100.0], []

    def select_later(*arguments: Any) -> tuple[list[int], list[int], list[int]]:
        """The terminal answers after half of each wait."""
        waits.append(round(arguments[3], 3))
        now_s[0] += arguments[3] / 2 if len(waits) < 3 else arguments[3]
        return [], [], []

    _, program = terminal
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    with terminal_keys(program) as keys, monkeypatch.context() as patched:
        patched.setattr("select.select", select_later)
        keys.wait(200_000_000)
        assert waits == [0.2, 0.1, 0.05]
        keys.wait(100_000_000)  # already past
        assert len(waits) == 3
