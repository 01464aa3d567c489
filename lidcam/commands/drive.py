"""The work of `lidcam drive`."""

import contextlib
import logging
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bags.simulator.drive.driving import Keyboard, ScriptedKeys, drive
from bags.simulator.drive.terminal import terminal_keys
from bags.simulator.vehicles.keys import RemoteControl, script_keys
from lidcam.commands.scenario import ScenarioOptions, recording_to, scenario_of
from lidcam.printing.escaping import visible
from lidcam.printing.log import progress_log
from lidcam.printing.terminal import console
from pipeline.core.errors import ConfigError

if TYPE_CHECKING:
    from bags.simulator.drive.live_view import LiveView
    from bags.simulator.recorder.simulation import Simulation

__all__ = ["DriveOptions", "run_drive"]


@dataclass(frozen=True, slots=True)
class DriveOptions(ScenarioOptions):
    """The command line of `drive`.

    Attributes:
        keys: Keys to press one after the other; None: those of the terminal, or of standard input.
        key_interval_s: Simulated seconds from one of `keys` to the next.
        view: Show the simulation in the Rerun viewer.
    """

    keys: str | None = None
    key_interval_s: float = 0.5
    view: bool = False


def run_drive(options: DriveOptions) -> None:
    """Let the user drive the cars of a scenario, record it, and say what was written.

    Raises:
        LidcamError: the scenario, the terminal or the output is at fault; no output is left behind.
    """
    scenario = scenario_of(options)
    drivable = tuple(name for name, vehicle in scenario.vehicles.items() if vehicle.commands)
    if not drivable:
        known = ", ".join(scenario.vehicles) or "none"
        raise ConfigError(
            f"{options.scenario}: expected a vehicle with `commands: true` to drive, found none; "
            f"--set vehicles.NAME.commands=true makes it one of {known}"
        )
    with contextlib.ExitStack() as resources:
        keyboard: Keyboard
        interval_ns = round(options.key_interval_s * 1e9)
        if options.keys is not None:
            keyboard = ScriptedKeys(_checked(options.keys, drivable), interval_ns)
        elif sys.stdin.isatty():
            keyboard = resources.enter_context(terminal_keys(sys.stdin.fileno()))
        else:
            keyboard = ScriptedKeys(_checked("".join(sys.stdin.read().split()), drivable), interval_ns)
        simulation, recorder = resources.enter_context(recording_to(options, scenario, driven=drivable))
        view = _viewer(simulation) if options.view else None
        end_ns = None if options.duration_s is None else round(options.duration_s * 1e9)
        status = resources.enter_context(contextlib.closing(_StatusLine()))
        for recorded, control in drive(simulation, keyboard, drivable, end_ns=end_ns):
            recorder.add(recorded)
            if view is not None:
                view.show(recorded)
            status.show(simulation, control)
    recorder.tell(options.output, simulation.now_ns)


def _checked(keys: str, drivable: tuple[str, ...]) -> str:
    """The keys of a script.

    Raises:
        ConfigError: a key has no meaning.
    """
    known = script_keys(drivable)
    if wrong := next((key for key in keys if key not in known), ""):
        raise ConfigError(f"keys: expected {' '.join(known)} (. waits), found {wrong!r} in {keys[:80]!r}")
    return keys


class _StatusLine:
    """One line with the car that is driven and its state, on a terminal only."""

    def __init__(self) -> None:
        self._console = console(stderr=True)
        self._shown = False

    def show(self, simulation: "Simulation", control: RemoteControl) -> None:
        """Rewrite the line."""
        if not self._console.is_terminal or not progress_log.isEnabledFor(logging.INFO):
            return
        state = simulation.state(control.chosen)
        cars = " ".join(f"{number} {visible(name)}" for number, name in enumerate(control.vehicles, 1))
        self._write(
            f"\r{simulation.now_ns * 1e-9:6.1f} s  {visible(control.chosen)} at {state.x_m:6.2f} {state.y_m:6.2f} m, "
            f"{state.speed_m_s:5.2f} m/s   w s a d x, {cars}, o ends \x1b[K"
        )
        self._shown = True

    def close(self) -> None:
        """End the line."""
        if self._shown:
            self._write("\n")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # the terminal has closed; the drive ends with its input
            self._console.file.write(text)
            self._console.file.flush()


def _viewer(simulation: "Simulation") -> "LiveView":
    from bags.simulator.drive.live_view import LiveView  # Rerun, which a drive without a view does not need

    return LiveView(simulation).spawn()
