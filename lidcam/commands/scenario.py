"""The recording of a scenario to a file, for `lidcam simulate` and `lidcam drive`."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from bags.simulator.recorder.files import (
    RecordingFormat,
    WriteMessage,
    format_of,
    recording_file,
    recording_names,
    recording_outputs,
    ros_version_of,
)
from bags.simulator.recorder.recorded import Recorded
from bags.simulator.recorder.start import simulating
from bags.simulator.scenario.load import load_scenario
from bags.simulator.scenario.scenario import Scenario
from lidcam.outputs.allowed import SIMULATED, TEXT, check_no_input, check_replaced
from lidcam.printing.log import remark_log
from readers.rig.rig_file import rig_yaml

if TYPE_CHECKING:
    from bags.simulator.recorder.simulation import Simulation

__all__ = ["Recorder", "ScenarioOptions", "recording_to", "scenario_of"]


@dataclass(frozen=True, slots=True)
class ScenarioOptions:
    """The scenario, and where it is recorded.

    Attributes:
        scenario: Name of a scenario, or a YAML file.
        output: The recording.
        format: Its format; None: the ending of its name decides.
        duration_s: Seconds to record; None: the scenario's.
        seed: Seed of all noise; None: the scenario's.
        overrides: Single values of the scenario.
        overwrite: Replace what is no simulated recording, too.
    """

    scenario: str
    output: Path
    format: RecordingFormat | None = None
    duration_s: float | None = None
    seed: int | None = None
    overrides: tuple[str, ...] = ()
    overwrite: bool = False


def scenario_of(options: ScenarioOptions) -> Scenario:
    """The scenario with the seed and the duration that were asked for.

    Raises:
        ConfigError: there is no such scenario, or a value does not fit.
    """
    scenario = load_scenario(options.scenario, options.overrides)
    asked = {"seed": options.seed, "duration_s": options.duration_s}
    return scenario.model_copy(update={key: value for key, value in asked.items() if value is not None})


class Recorder:
    """Writes messages to a file and counts them."""

    def __init__(self, write: WriteMessage, start_ns: int) -> None:
        self._write, self._start_ns = write, start_ns
        self.messages = 0

    def add(self, recorded: list[Recorded]) -> None:
        """Write the messages of one step."""
        for one in recorded:
            self._write(one, self._start_ns)
        self.messages += len(recorded)

    def tell(self, output: Path, now_ns: int) -> None:
        """Say what was written."""
        files = [output] if output.is_file() else sorted(output.iterdir())
        size_mib = sum(file.stat().st_size for file in files) / 2**20
        remark_log.info("wrote %s: %d messages, %.1f s, %.1f MiB", output, self.messages, now_ns * 1e-9, size_mib)


@contextlib.contextmanager
def recording_to(
    options: ScenarioOptions, scenario: Scenario, *, workers: int | None = None, driven: tuple[str, ...] = ()
) -> Iterator[tuple["Simulation", Recorder]]:
    """A simulation and the file that it is recorded to.

    Args:
        options: Where it is recorded.
        scenario: What is simulated.
        workers: Sensors simulated at once; None: one per core.
        driven: Vehicles that wait at their start until they are driven.

    Raises:
        OutputError: the file cannot be written.
    """
    format = format_of(options.output, options.format)
    version = ros_version_of(format)
    check_no_input(recording_names(options.output, format), [Path(options.scenario)])
    check_old = check_replaced(lambda path: TEXT if path.suffix == ".yaml" else SIMULATED, overwrite=options.overwrite)
    text = yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=100)
    with (
        recording_outputs(options.output, format, check_old=check_old) as outputs,
        simulating(scenario, ros_version=version, workers=workers, driven=driven) as simulation,
    ):
        rig = rig_yaml(simulation.true_rig)
        with recording_file(outputs, options.output, format, rig_yaml=rig, scenario_yaml=text) as write:
            yield simulation, Recorder(write, scenario.start_ns)
