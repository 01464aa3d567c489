"""The command `lidcam drive`."""

import contextlib
import logging
import sys
from typing import TYPE_CHECKING, Annotated

from lidcam.cli.options import Overwrite, RecordingOut, Scenario, Seed, Setting, duration, option, with_log_options
from lidcam.cli.printing.escaping import visible
from lidcam.cli.printing.log import progress_log
from lidcam.cli.simulation.simulate import log_recording
from lidcam.pipeline.core.errors import ConfigError

if TYPE_CHECKING:
    from lidcam.bags.simulator.drive.driving import RemoteControl, ScriptedKeys, TerminalKeys
    from lidcam.bags.simulator.recorder.simulation import Simulation

DRIVE_EXAMPLES = """\
Keys: w forward, s back, a left, d right, x stop, 1 and 2 choose the car,
o ends. A command holds until the next one.

\b
Examples:
  lidcam drive sandbox out.bag --view
  lidcam drive sandbox out.mcap --keys "wwadx2ww"
"""


@with_log_options
def drive(
    scenario: Scenario,
    output: RecordingOut,
    keys: Annotated[
        str | None, option("Press these keys, as fast as the simulation runs, and exit.", metavar="KEYS")
    ] = None,
    key_interval: Annotated[float, option("Simulated seconds between --keys.", metavar="S", min=0.01, max=60)] = 0.5,
    view: Annotated[bool, option("Show the drive in the Rerun viewer.", "--view")] = False,
    duration_s: Annotated[
        float | None, option("End after S simulated seconds.", "--duration", metavar="S", min=0, callback=duration)
    ] = None,
    seed: Seed = None,
    settings: Setting = None,
    overwrite: Overwrite = False,
) -> None:
    """Drive the cars of a scenario from the keyboard, and record it."""
    from lidcam.simulation import check_simulator, recording_to, scenario_of

    check_simulator()
    from lidcam.bags.simulator.drive.driving import drive as driven

    found = scenario_of(scenario, settings or (), duration_s=duration_s, seed=seed)
    drivable = tuple(name for name, vehicle in found.vehicles.items() if vehicle.commands)
    if not drivable:
        known = ", ".join(found.vehicles) or "none"
        raise ConfigError(
            f"{scenario}: expected a vehicle with `commands: true` to drive, found none; "
            f"--set vehicles.NAME.commands=true makes it one of {known}"
        )
    with contextlib.ExitStack() as resources:
        keyboard = _keyboard(keys, key_interval, drivable, resources)
        opened = recording_to(output, found, read=scenario, overwrite=overwrite, driven=drivable)
        simulation, write = resources.enter_context(opened)
        viewer = None
        if view:
            from lidcam.bags.simulator.drive.live_view import LiveView  # loads Rerun

            viewer = LiveView(simulation).spawn()
        end_ns = None if duration_s is None else round(duration_s * 1e9)
        status, messages = resources.enter_context(contextlib.closing(_StatusLine())), 0
        for recorded, control in driven(simulation, keyboard, drivable, end_ns=end_ns):
            for one in recorded:
                write(one, found.start_ns)
            messages += len(recorded)
            if viewer is not None:
                viewer.show(recorded)
            status.show(simulation, control)
    log_recording(output, messages, simulation.now_ns * 1e-9)


def _keyboard(
    keys: str | None, interval_s: float, drivable: tuple[str, ...], resources: contextlib.ExitStack
) -> "ScriptedKeys | TerminalKeys":
    """The given keys, else those of the terminal, else those on stdin."""
    from lidcam.bags.simulator.drive.driving import ScriptedKeys, script_keys, terminal_keys

    if keys is None and sys.stdin.isatty():
        return resources.enter_context(terminal_keys(sys.stdin.fileno()))
    given = "".join(sys.stdin.read().split()) if keys is None else keys
    known = script_keys(drivable)
    if wrong := next((key for key in given if key not in known), ""):
        raise ConfigError(f"keys: expected {' '.join(known)} (. waits), found {wrong!r} in {given[:80]!r}")
    return ScriptedKeys(given, round(interval_s * 1e9))


class _StatusLine:
    """A line with the driven car and its state, on a terminal only."""

    def __init__(self) -> None:
        from lidcam.cli.printing.terminal import console

        self._console = console(stderr=True)
        self._shown = False

    def show(self, simulation: "Simulation", control: "RemoteControl") -> None:
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
