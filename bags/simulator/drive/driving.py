"""Driving the cars of a scenario with keys, step by step."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bags.simulator.drive.keyboard import Keyboard
from bags.simulator.recorder.recorded import STEP_NS, Recorded
from bags.simulator.vehicles.keys import RemoteControl

if TYPE_CHECKING:
    from bags.simulator.recorder.simulation import Simulation

__all__ = ["drive"]


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
