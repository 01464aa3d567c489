"""Driving the cars of a scenario with keys, step by step.

Keys come from a script or, with `lidcam.bags.simulator.drive.driving`, from a terminal.
"""

import contextlib
import os
import select
import signal
import termios
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from lidcam.bags.simulator.recorder.processes import STEP_NS, Recorded
from lidcam.bags.simulator.vehicles.keys import RemoteControl
from lidcam.pipeline.core.ending import undone_at_once

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.simulation import Simulation


class Pressed(NamedTuple):
    """The keys that were pressed, in order, and whether the input has ended."""

    keys: str
    ended: bool


class Keyboard(Protocol):
    """A source of keys. Times are simulated, in nanoseconds."""

    def pressed(self, now_ns: int) -> Pressed:
        """The keys to apply now; each is returned once."""

    def next_ns(self, now_ns: int) -> int:
        """When to ask again; later than now."""

    def wait(self, until_ns: int) -> None:
        """Let real time catch up with the simulation if keys come in real time."""


@dataclass(frozen=True, slots=True)
class ScriptedKeys:
    """Keys pressed at a fixed pace from the start; then the input ends."""

    script: str
    interval_ns: int

    def pressed(self, now_ns: int) -> Pressed:
        """See `Keyboard`."""
        number, between = divmod(now_ns, self.interval_ns)
        keys = self.script[number : number + 1] if between == 0 else ""
        return Pressed(keys, number >= len(self.script))

    def next_ns(self, now_ns: int) -> int:
        """See `Keyboard`."""
        return (now_ns // self.interval_ns + 1) * self.interval_ns

    def wait(self, until_ns: int) -> None:
        """Do nothing: a script runs in simulated time."""


def drive(
    simulation: "Simulation", keyboard: Keyboard, drivable: tuple[str, ...], *, end_ns: int | None = None
) -> Iterator[tuple[list[Recorded], RemoteControl]]:
    """Simulate step by step under keyboard control until the quit key, the end of input, or `end_ns`.

    Yields:
        The messages of a step, and the state of the remote control; at the end the measurements still under way.
    """
    control = RemoteControl.of(drivable)
    now_ns = 0
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


# DOC Keys from a terminal as they are pressed, without Enter or echo; the terminal is always restored.


ASK_NS = 50_000_000
"""Keys are read at least this often in simulated time."""

ENDINGS = (signal.SIGINT, signal.SIGHUP)
"""Ctrl-C and a closed terminal: both end the drive and keep the recording."""


class TerminalKeys:
    """Keys of an open terminal; see `lidcam.bags.simulator.drive.driving.Keyboard`.

    Simulated time never runs ahead of real time.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._begin = time.monotonic()
        self._keys = ""
        self._ended = False

    def end(self) -> None:
        """End the input."""
        self._ended = True

    def pressed(self, now_ns: int) -> Pressed:
        """See `lidcam.bags.simulator.drive.driving.Keyboard`."""
        del now_ns
        self._read(0.0)
        keys, self._keys = self._keys, ""
        return Pressed(keys, self._ended)

    def next_ns(self, now_ns: int) -> int:
        """See `lidcam.bags.simulator.drive.driving.Keyboard`."""
        return now_ns + ASK_NS

    def wait(self, until_ns: int) -> None:
        """See `lidcam.bags.simulator.drive.driving.Keyboard`; returns early at the end of input, not at a key."""
        while not self._ended and (left_s := self._begin + until_ns * 1e-9 - time.monotonic()) > 0:
            self._read(left_s)

    def _read(self, seconds: float) -> None:
        """Read the keys that are pending, or that come within a time."""
        try:
            ready, _, _ = select.select([self._descriptor], [], [], seconds)
            if not ready:
                return
            data = os.read(self._descriptor, 1024)
        except OSError:  # the terminal is gone
            data = b""
        self._keys += data.decode("ascii", errors="ignore")
        self._ended = self._ended or not data or b"\x04" in data  # in this mode Ctrl-D is a byte


@contextlib.contextmanager
def terminal_keys(descriptor: int) -> Iterator[TerminalKeys]:
    """The keys of a terminal; Ctrl-C and a closed terminal end its input, even when signalled repeatedly."""
    keys = TerminalKeys(descriptor)
    before = termios.tcgetattr(descriptor)
    handlers: dict[int, Any] = {number: signal.getsignal(number) for number in ENDINGS}

    def end(_: int, __: FrameType | None) -> None:
        keys.end()

    restore_now = partial(termios.tcsetattr, descriptor, termios.TCSANOW, before)
    try:
        for number in ENDINGS:
            signal.signal(number, end)
        with undone_at_once(restore_now):
            tty.setcbreak(descriptor)
            yield keys
    finally:
        with contextlib.suppress(OSError, termios.error):  # the terminal may be gone
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        for ending, handler in handlers.items():
            signal.signal(ending, handler)
