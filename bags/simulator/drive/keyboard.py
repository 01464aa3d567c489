"""Where the keys come from that drive cars: a script here, a terminal in `bags.simulator.drive.terminal`."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

__all__ = ["Keyboard", "Pressed", "ScriptedKeys"]


class Pressed(NamedTuple):
    """What was pressed.

    Attributes:
        keys: In their order.
        ended: Whether no more will come.
    """

    keys: str
    ended: bool


class Keyboard(Protocol):
    """Where keys come from. Times are the simulation's, in nanoseconds."""

    def pressed(self, now_ns: int) -> Pressed:
        """The keys to be applied now, each told once."""
        ...

    def next_ns(self, now_ns: int) -> int:
        """When to ask again, later than now."""
        ...

    def wait(self, until_ns: int) -> None:
        """Let real time catch up with the simulation, if keys come in real time."""
        ...


@dataclass(frozen=True, slots=True)
class ScriptedKeys:
    """Keys that are pressed one after the other at a fixed pace, from the start; then the input ends.

    Attributes:
        script: The keys.
        interval_ns: From one to the next.
    """

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
        """Nobody waits."""
