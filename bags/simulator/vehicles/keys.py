"""The keys of the original's remote control, and what they make of the cars.

Nothing here reads a terminal: keys come in, commands come out.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from bags.simulator.vehicles.ackermann import AckermannCommand

__all__ = ["QUIT", "RemoteControl", "command_of", "commands_of_keys", "script_keys"]

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
    """All keys that mean something in a script; the last one only lets its time pass."""
    return "".join(_COMMANDS) + "123456789"[: len(vehicles)] + QUIT + WAIT


def command_of(key: str) -> AckermannCommand | None:
    """What a key tells the car; None for one that tells it nothing."""
    return _COMMANDS.get(key)


def commands_of_keys(keys: str, interval_s: float) -> list[tuple[int, AckermannCommand]]:
    """Times in nanoseconds and commands of keys that are pressed one after the other, from time 0.

    A key that tells the car nothing only lets its time pass; what follows the key to quit is not pressed any more.
    """
    pressed = ((number, command_of(key)) for number, key in enumerate(keys.partition(QUIT)[0]))
    return [(round(number * interval_s * 1e9), command) for number, command in pressed if command is not None]


@dataclass(frozen=True, slots=True)
class RemoteControl:
    """Which car is driven, and what was asked of each; a command holds until the next one to the same car.

    Attributes:
        vehicles: Those that can be driven; the keys 1, 2... choose among them.
        chosen: Name of the one that is driven.
        commands: By vehicle, as far as any was given.
        done: Whether the key to quit was pressed.
    """

    vehicles: tuple[str, ...]
    chosen: str
    commands: Mapping[str, AckermannCommand] = field(default_factory=dict)
    done: bool = False

    @classmethod
    def of(cls, vehicles: tuple[str, ...]) -> "RemoteControl":
        """Nothing was pressed yet; the first vehicle is chosen.

        Raises:
            ValueError: there is no vehicle.
        """
        if not vehicles:
            raise ValueError("expected one vehicle to drive at least, got none")
        return cls(vehicles, vehicles[0])

    def pressed(self, key: str) -> "RemoteControl":
        """As it is after a key; one without a meaning changes nothing."""
        if key == QUIT:
            return replace(self, done=True)
        if key in "123456789"[: len(self.vehicles)] and key:
            return replace(self, chosen=self.vehicles[int(key) - 1])
        command = command_of(key)
        if command is None:
            return self
        return replace(self, commands={**self.commands, self.chosen: command})
