"""Driving the cars of a scenario with keys, step by step.

Keys come from a script or, with `lidcam.bags.simulator.drive.terminal`, from a terminal.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

from lidcam.bags.simulator.recorder.recorded import STEP_NS, Recorded
from lidcam.bags.simulator.vehicles.keys import RemoteControl

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
