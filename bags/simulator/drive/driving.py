"""Driving the cars of a scenario with keys, from a script or from a terminal, step by step."""

import contextlib
import os
import select
import signal
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from lidcam.bags.simulator.recorder.recorded import STEP_NS, Recorded
from lidcam.bags.simulator.vehicles.ackermann import KEY_COMMANDS, QUIT, AckermannCommand
from lidcam.pipeline.core.ending import undone_at_once

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.simulation import Simulation

TERMINAL_POLL_NS = 50_000_000  # longest simulated time between two readings of a terminal


def script_keys(vehicles: tuple[str, ...]) -> str:
    """All keys with a meaning in a script; the last one only waits."""
    return "".join(KEY_COMMANDS) + "123456789"[: len(vehicles)] + QUIT + "."


@dataclass(frozen=True, slots=True)
class RemoteControl:
    """The state of the remote control; a command holds until the next one to the same car."""

    vehicles: tuple[str, ...]  # chosen by the keys 1, 2...
    chosen: str
    commands: Mapping[str, AckermannCommand] = field(default_factory=dict)
    done: bool = False  # the quit key was pressed

    def pressed(self, key: str) -> "RemoteControl":
        """The state after a key; a key without a meaning changes nothing."""
        if key == QUIT:
            return replace(self, done=True)
        if key and key in "123456789"[: len(self.vehicles)]:
            return replace(self, chosen=self.vehicles[int(key) - 1])
        if key not in KEY_COMMANDS:
            return self
        return replace(self, commands={**self.commands, self.chosen: KEY_COMMANDS[key]})


class Pressed(NamedTuple):
    """The keys that were pressed, in order, and whether the input has ended."""

    keys: str
    ended: bool


@dataclass(frozen=True, slots=True)
class ScriptedKeys:
    """Keys that are pressed at a fixed pace from the start, in simulated time; then the input ends."""

    script: str
    interval_ns: int

    def pressed(self, now_ns: int) -> Pressed:
        """The keys to apply now; each is returned once."""
        number, between = divmod(now_ns, self.interval_ns)
        keys = self.script[number : number + 1] if between == 0 else ""
        return Pressed(keys, number >= len(self.script))

    def next_ns(self, now_ns: int) -> int:
        """When to ask again, later than now; nanoseconds."""
        return (now_ns // self.interval_ns + 1) * self.interval_ns

    def wait(self, until_ns: int) -> None:
        """Nothing: such keys do not come in real time."""


class TerminalKeys:
    """The keys of an open terminal; simulated time never runs ahead of real time."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._begin_s = descriptor, time.monotonic()
        self._keys, self._ended = "", False

    def end(self) -> None:
        """End the input."""
        self._ended = True

    def pressed(self, now_ns: int) -> Pressed:  # noqa: ARG002  # as of a script, which goes by it
        """The keys since the last call."""
        self._read(0.0)
        keys, self._keys = self._keys, ""
        return Pressed(keys, self._ended)

    def next_ns(self, now_ns: int) -> int:
        """When to ask again, later than now; nanoseconds."""
        return now_ns + TERMINAL_POLL_NS

    def wait(self, until_ns: int) -> None:
        """Wait until real time is there; returns early at the end of input, not at a key."""
        while not self._ended and (left_s := self._begin_s + until_ns * 1e-9 - time.monotonic()) > 0:
            self._read(left_s)

    def _read(self, timeout_s: float) -> None:
        try:
            ready, _, _ = select.select([self._descriptor], [], [], timeout_s)
            if not ready:
                return
            data = os.read(self._descriptor, 1024)
        except OSError:  # the terminal is gone
            data = b""
        self._keys += data.decode("ascii", errors="ignore")
        self._ended = self._ended or not data or b"\x04" in data  # in this mode Ctrl-D is a byte


@contextlib.contextmanager
def terminal_keys(descriptor: int) -> Iterator[TerminalKeys]:
    """The keys of a terminal as they are pressed, without Enter or echo; the terminal is always restored.

    Ctrl-C and a closed terminal end the input, even when signalled repeatedly, and keep the recording.
    """
    import termios  # Windows has none, and simulates without terminal
    import tty

    ending_signals = signal.SIGINT, signal.SIGHUP
    keys, before = TerminalKeys(descriptor), termios.tcgetattr(descriptor)
    handlers: dict[int, Any] = {number: signal.getsignal(number) for number in ending_signals}
    try:
        for number in ending_signals:
            signal.signal(number, lambda *_: keys.end())
        with undone_at_once(partial(termios.tcsetattr, descriptor, termios.TCSANOW, before)):
            tty.setcbreak(descriptor)
            yield keys
    finally:
        with contextlib.suppress(OSError, termios.error):  # the terminal may be gone
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        for ending, handler in handlers.items():
            signal.signal(ending, handler)


def drive(
    simulation: "Simulation",
    keyboard: ScriptedKeys | TerminalKeys,
    drivable: tuple[str, ...],
    *,
    end_ns: int | None = None,
) -> Iterator[tuple[list[Recorded], RemoteControl]]:
    """Simulate step by step under keyboard control until the quit key, the end of input, or `end_ns`.

    Yields the messages of a step and the state of the remote control; at the end the measurements still under way.
    """
    control, now_ns = RemoteControl(drivable, drivable[0]), 0
    while True:
        keys, ended = keyboard.pressed(now_ns)
        for key in keys:
            control = control if control.done else control.pressed(key)
        for name, command in control.commands.items():
            simulation.command(name, command)
        if control.done or ended or (end_ns is not None and now_ns >= end_ns):
            break
        until_ns = min(keyboard.next_ns(now_ns), now_ns + STEP_NS, *([] if end_ns is None else [end_ns]))
        yield simulation.step(until_ns), control
        keyboard.wait(until_ns)
        now_ns = until_ns
    yield simulation.finish(), control
