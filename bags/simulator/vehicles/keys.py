"""Remote control by keys, the same as in the predecessor system: from keys to commands."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand

SPEED_M_S = 0.3
STEERING_RAD = 0.7 * 0.7
QUIT = "o"
WAIT = "."

_COMMANDS = {
    "w": AckermannCommand(SPEED_M_S, 0.0),
    "s": AckermannCommand(-SPEED_M_S, 0.0),
    "a": AckermannCommand(SPEED_M_S, STEERING_RAD),
    "d": AckermannCommand(SPEED_M_S, -STEERING_RAD),
    "x": AckermannCommand(0.0, 0.0),
}


def script_keys(vehicles: tuple[str, ...]) -> str:
    """All keys with a meaning in a script; the last one only waits."""
    return "".join(_COMMANDS) + "123456789"[: len(vehicles)] + QUIT + WAIT


def command_of(key: str) -> AckermannCommand | None:
    """The command of a key; None if it has none."""
    return _COMMANDS.get(key)


def commands_of_keys(keys: str, interval_s: float) -> list[tuple[int, AckermannCommand]]:
    """Times in nanoseconds and commands of keys pressed at a fixed pace from time 0.

    A key without a command only waits; keys after the quit key are ignored.
    """
    pressed = ((number, command_of(key)) for number, key in enumerate(keys.partition(QUIT)[0]))
    return [(round(number * interval_s * 1e9), command) for number, command in pressed if command is not None]


@dataclass(frozen=True, slots=True)
class RemoteControl:
    """The state of the remote control; a command holds until the next one to the same car."""

    vehicles: tuple[str, ...]  # Vehicles that can be driven, chosen by the keys 1, 2
    chosen: str  # Name of the chosen vehicle
    commands: Mapping[str, AckermannCommand] = field(default_factory=dict)  # Last command by vehicle
    done: bool = False  # Whether the quit key was pressed

    @classmethod
    def of(cls, vehicles: tuple[str, ...]) -> "RemoteControl":
        """The initial state, with the first vehicle chosen; there is at least one."""
        return cls(vehicles, vehicles[0])

    def pressed(self, key: str) -> "RemoteControl":
        """The state after a key; a key without a meaning changes nothing."""
        if key == QUIT:
            return replace(self, done=True)
        if key in "123456789"[: len(self.vehicles)] and key:
            return replace(self, chosen=self.vehicles[int(key) - 1])
        command = command_of(key)
        if command is None:
            return self
        return replace(self, commands={**self.commands, self.chosen: command})
