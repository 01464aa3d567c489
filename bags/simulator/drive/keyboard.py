"""Sources of keys: the protocol, and a script; `bags.simulator.drive.terminal` has the terminal."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

__all__ = ["Keyboard", "Pressed", "ScriptedKeys"]


class Pressed(NamedTuple):
    """Keys that were pressed.

    Attributes:
        keys: The keys in order.
        ended: Whether the input has ended.
    """

    keys: str
    ended: bool


class Keyboard(Protocol):
    """A source of keys. Times are simulated, in nanoseconds."""

    def pressed(self, now_ns: int) -> Pressed:
        """The keys to apply now; each is returned once."""
        ...

    def next_ns(self, now_ns: int) -> int:
        """When to ask again; later than now."""
        ...

    def wait(self, until_ns: int) -> None:
        """Let real time catch up with the simulation if keys come in real time."""
        ...


@dataclass(frozen=True, slots=True)
class ScriptedKeys:
    """Keys pressed at a fixed pace from the start; then the input ends.

    Attributes:
        script: The keys.
        interval_ns: Time between keys.
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
        """Do nothing: a script runs in simulated time."""
