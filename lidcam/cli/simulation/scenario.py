"""The recording of a scenario to a file, for `lidcam simulate` and `lidcam drive`."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from lidcam.bags.simulator.recorder.files import (
    WriteMessage,
    recording_file,
    recording_names,
    ros_version_of,
)
from lidcam.bags.simulator.recorder.recorded import Recorded
from lidcam.bags.simulator.recorder.start import simulating
from lidcam.bags.simulator.scenario.load import load_scenario, overridden
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.worlds.errors import with_errors
from lidcam.cli.printing.log import remark_log
from lidcam.outputs.allowed import SIMULATED, TEXT, check_no_input, check_replaced
from lidcam.readers.rig.rig_file import rig_yaml
from lidcam.writers.outputs.transaction import OutputTransaction

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.simulation import Simulation
    from lidcam.bags.simulator.worlds.draw import Family


def scenario_of(
    name: str,
    settings: Sequence[str],
    *,
    duration_s: float | None,
    seed: int | None,
    family: "Family | None" = None,
    errors: bool | None = None,
) -> Scenario:
    """A bundled scenario or a YAML file, or one of a family drawn from the seed, by default 1.

    Settings, duration and seed override its own. Sensors have errors drawn from the seed if `errors` is set; None: if
    the scenario is drawn, too.

    Raises:
        ConfigError: there is no such scenario, or a value does not fit.
    """
    if family is None:
        scenario = load_scenario(name, tuple(settings))
    else:
        from lidcam.bags.simulator.worlds.draw import random_scenario  # OpenCV

        scenario = overridden(random_scenario(family, 1 if seed is None else seed), tuple(settings))
    given = {"seed": seed, "duration_s": duration_s}
    scenario = scenario.model_copy(update={key: value for key, value in given.items() if value is not None})
    return with_errors(scenario) if errors or (errors is None and family) else scenario


class Recorder:
    """Writes messages to a file and counts them."""

    def __init__(self, write: WriteMessage, start_ns: int) -> None:
        self._write, self._start_ns = write, start_ns
        self.messages = 0

    def write_messages(self, recorded: list[Recorded]) -> None:
        """Write the messages of one step."""
        for one in recorded:
            self._write(one, self._start_ns)
        self.messages += len(recorded)

    def log_files(self, output: Path, now_ns: int) -> None:
        """Log what was written."""
        size_mib = output.stat().st_size / 2**20
        remark_log.info("wrote %s: %d messages, %.1f s, %.1f MiB", output, self.messages, now_ns * 1e-9, size_mib)


@contextlib.contextmanager
def recording_to(
    output: Path,
    scenario: Scenario,
    *,
    read: str,
    overwrite: bool,
    workers: int | None = None,
    driven: tuple[str, ...] = (),
) -> Iterator[tuple["Simulation", Recorder]]:
    """A simulation and the file that it is recorded to.

    Args:
        output: The recording; the ending of its name says its format.
        scenario: The scenario.
        read: The name that it was read from; the output must not replace that file.
        overwrite: Overwrite files that are not simulated recordings.
        workers: Sensors simulated at once; None: one per core.
        driven: Vehicles that wait at their start until they are driven.

    Raises:
        OutputError: the file cannot be written.
    """
    version, files = ros_version_of(output), recording_names(output)
    check_no_input(files, [Path(read)])
    check_old = check_replaced(lambda path: TEXT if path.suffix == ".yaml" else SIMULATED, overwrite=overwrite)
    text = yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=100)
    with (
        OutputTransaction(files, check_old=check_old) as outputs,
        simulating(scenario, ros_version=version, workers=workers, driven=driven) as simulation,
    ):
        from lidcam.bags.simulator.recorder.true_rig import true_rig  # OpenCV, which a simulation has loaded by now

        rig = rig_yaml(true_rig(scenario))
        with recording_file(outputs, output, rig_yaml=rig, scenario_yaml=text) as write:
            yield simulation, Recorder(write, scenario.start_ns)
