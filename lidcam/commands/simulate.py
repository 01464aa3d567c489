"""What `lidcam simulate` and `lidcam drive` do."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from bags.simulator.drive.driving import drive
from bags.simulator.drive.keyboard import Keyboard, ScriptedKeys
from bags.simulator.drive.terminal import terminal_keys
from bags.simulator.recorder.files import MessageWriter, RecordingFormat, format_of, recording_file, ros_version_of
from bags.simulator.recorder.recorded import Recorded
from bags.simulator.recorder.start import simulating
from bags.simulator.scenario.load import load_scenario
from bags.simulator.scenario.scenario import Scenario
from bags.simulator.vehicles.keys import RemoteControl, script_keys
from pipeline.core.errors import ConfigError
from readers.rig.rig_file import rig_yaml

if TYPE_CHECKING:
    from bags.simulator.drive.live_view import LiveView
    from bags.simulator.recorder.simulation import Simulation

__all__ = ["DriveOptions", "SimulateOptions", "run_drive", "run_simulate"]


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """The command line of `simulate`."""

    scenario: str
    output: Path
    format: RecordingFormat | None = None
    duration_s: float | None = None
    seed: int | None = None
    overrides: tuple[str, ...] = ()
    workers: int | None = None


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """The command line of `drive`."""

    scenario: str
    output: Path
    format: RecordingFormat | None = None
    duration_s: float | None = None
    seed: int | None = None
    overrides: tuple[str, ...] = ()
    keys: str | None = None
    key_interval_s: float = 0.5
    view: bool = False


def run_simulate(options: SimulateOptions) -> None:
    """Record a scenario and tell what was written.

    Raises:
        LidcamError: the scenario or the output is at fault; no output is left behind.
    """
    scenario = _scenario(options)
    with _recording(scenario, options) as (simulation, recorder), _progress(scenario.duration_s) as progress:
        for recorded in simulation.run(scenario.duration_s):
            recorder.add(recorded)
            progress(simulation.now_ns * 1e-9)
    recorder.tell(options.output, simulation.now_ns)


def run_drive(options: DriveOptions) -> None:
    """Let somebody drive the cars of a scenario, and record it; then tell what was written.

    Raises:
        LidcamError: the scenario, the terminal or the output is at fault; no output is left behind.
    """
    scenario = _scenario(options)
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
        simulation, recorder = resources.enter_context(_recording(scenario, options, driven=drivable))
        view = _viewer(simulation) if options.view else None
        end_ns = None if options.duration_s is None else round(options.duration_s * 1e9)
        status = resources.enter_context(contextlib.closing(_StatusLine()))
        for recorded, control in drive(simulation, keyboard, drivable, end_ns=end_ns):
            recorder.add(recorded)
            if view is not None:
                view.show(recorded)
            status.show(simulation, control)
    recorder.tell(options.output, simulation.now_ns)


def _scenario(options: SimulateOptions | DriveOptions) -> Scenario:
    """As it is simulated: with the seed and the duration that were asked for."""
    scenario = load_scenario(options.scenario, options.overrides)
    asked = {"seed": options.seed, "duration_s": options.duration_s}
    return scenario.model_copy(update={key: value for key, value in asked.items() if value is not None})


def _checked(keys: str, drivable: tuple[str, ...]) -> str:
    """Keys of a script, all of which mean something.

    Raises:
        ConfigError: one does not.
    """
    known = script_keys(drivable)
    if wrong := next((key for key in keys if key not in known), ""):
        raise ConfigError(f"keys: expected {' '.join(known)} (. waits), found {wrong!r} in {keys[:80]!r}")
    return keys


class _Recorder:
    """Puts messages into a file and counts them."""

    def __init__(self, writer: MessageWriter, start_ns: int) -> None:
        self._writer, self._start_ns = writer, start_ns
        self.messages = 0

    def add(self, recorded: list[Recorded]) -> None:
        """Write what was recorded in one step."""
        for one in recorded:
            self._writer.write(one, self._start_ns)
        self.messages += len(recorded)

    def tell(self, output: Path, now_ns: int) -> None:
        """Say what was written."""
        files = [output] if output.is_file() else sorted(output.iterdir())
        size_mib = sum(file.stat().st_size for file in files) / 2**20
        with contextlib.suppress(OSError):  # a terminal that is gone hears nothing; the recording is whole
            _console().print(f"wrote {output}: {self.messages} messages, {now_ns * 1e-9:.1f} s, {size_mib:.1f} MiB")


class _StatusLine:
    """One line that says who is driven and how, on a terminal only."""

    def __init__(self) -> None:
        self._console = _console()
        self._shown = False

    def show(self, simulation: "Simulation", control: RemoteControl) -> None:
        """Write the line anew."""
        if not self._console.is_terminal:
            return
        state = simulation.state(control.chosen)
        cars = " ".join(f"{number} {name}" for number, name in enumerate(control.vehicles, 1))
        self._write(
            f"\r{simulation.now_ns * 1e-9:6.1f} s  {control.chosen} at {state.x_m:6.2f} {state.y_m:6.2f} m, "
            f"{state.speed_m_s:5.2f} m/s   w s a d x, {cars}, o ends \x1b[K"
        )
        self._shown = True

    def close(self) -> None:
        """Leave the line."""
        if self._shown:
            self._write("\n")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # the terminal is gone; the drive ends with its input
            self._console.file.write(text)
            self._console.file.flush()


@contextlib.contextmanager
def _recording(
    scenario: Scenario, options: SimulateOptions | DriveOptions, *, driven: tuple[str, ...] = ()
) -> Iterator[tuple["Simulation", _Recorder]]:
    """A simulation and the file that it is recorded to."""
    format = format_of(options.output, options.format)
    workers = options.workers if isinstance(options, SimulateOptions) else None
    version = ros_version_of(format)
    text = yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=100)
    with simulating(scenario, ros_version=version, workers=workers, driven=driven) as simulation:
        rig = rig_yaml(simulation.true_rig)
        with recording_file(options.output, format, rig_yaml=rig, scenario_yaml=text) as writer:
            yield simulation, _Recorder(writer, scenario.start_ns)


def _viewer(simulation: "Simulation") -> "LiveView":
    from bags.simulator.drive.live_view import LiveView  # Rerun, which a drive without a view does not need

    return LiveView(simulation).spawn()


@contextlib.contextmanager
def _progress(duration_s: float) -> Iterator[Callable[[float], None]]:
    """Progress over simulated time, on a terminal only."""
    err = _console()
    if not err.is_terminal:
        yield lambda _: None
        return
    columns = (TextColumn("{task.completed:.1f} of {task.total:.1f} s"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task("", total=duration_s)
        yield lambda now_s: progress.update(task, completed=now_s)


def _console() -> Console:
    return Console(stderr=True, soft_wrap=True, markup=False, emoji=False)
