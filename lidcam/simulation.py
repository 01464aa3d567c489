"""The recording of a scenario to a file."""

import contextlib
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import yaml

from lidcam.bags.simulator.recorder.files import WriteMessage, recording_file, recording_names, ros_version_of
from lidcam.bags.simulator.recorder.start import simulating
from lidcam.bags.simulator.scenario.scenario import Scenario, load_scenario, overridden
from lidcam.bags.simulator.worlds.errors import with_errors
from lidcam.evaluation.evaluate import Progress, not_shown
from lidcam.outputs.allowed import SIMULATED, TEXT, check_no_input, check_replaced
from lidcam.pipeline.core.errors import ConfigError, LidcamError
from lidcam.readers.rig.rig_file import rig_yaml
from lidcam.writers.outputs.transaction import OutputTransaction

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.simulation import Simulation
    from lidcam.bags.simulator.worlds.draw import Family

RANDOM = "random"
"""Name of the scenarios that are drawn from a seed."""


def check_simulator() -> None:
    """Check that the extra `sim` and the system libraries that it needs are installed."""
    for package in ("open3d", "libusb_package"):
        if find_spec(package) is None:
            raise LidcamError(f"the simulator needs {package}, which is not installed: pip install 'lidcam[sim]'")
    from lidcam.bags.simulator.world.open3d_runtime import check_libraries

    check_libraries()


def simulate_recording(
    scenario: str,
    output: Path,
    *,
    duration_s: float | None = None,
    seed: int | None = None,
    family: Literal["sandbox", "crossing", "road"] | None = None,
    errors: bool | None = None,
    settings: Sequence[str] = (),
    overwrite: bool = False,
    workers: int | None = None,
    show: Progress = not_shown,
) -> tuple[int, float]:
    """Record a simulated scene; arguments as in `lidcam.simulate`.

    Returns:
        Number of messages, and seconds that were recorded.

    Raises:
        LidcamError: the simulator is not installed, there is no such scenario, a value does not fit, or the recording
            cannot be written.
    """
    if family is not None and scenario != RANDOM:
        raise ConfigError(f"family: expected the scenario {RANDOM} with it, found {scenario}")
    if duration_s is not None and not duration_s > 0:
        raise ConfigError(f"duration_s: expected more than 0 s, found {duration_s:g}")
    check_simulator()
    if scenario == RANDOM:
        family = family or "road"
    found = scenario_of(scenario, settings, duration_s=duration_s, seed=seed, family=family, errors=errors)
    with (
        recording_to(output, found, read=scenario, overwrite=overwrite, workers=workers) as opened,
        show(found.duration_s) as advance,
    ):
        (simulation, write), messages = opened, 0
        for recorded in simulation.run(found.duration_s):
            for one in recorded:
                write(one, found.start_ns)
            messages += len(recorded)
            advance(simulation.now_ns * 1e-9, f"{messages} messages")
    return messages, simulation.now_ns * 1e-9


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
    """
    if family is None:
        scenario = load_scenario(name, tuple(settings))
    else:
        from lidcam.bags.simulator.worlds.draw import random_scenario  # OpenCV

        scenario = overridden(random_scenario(family, 1 if seed is None else seed), tuple(settings))
    given = {"seed": seed, "duration_s": duration_s}
    scenario = scenario.model_copy(update={key: value for key, value in given.items() if value is not None})
    return with_errors(scenario) if errors or (errors is None and family) else scenario


@contextlib.contextmanager
def recording_to(
    output: Path,
    scenario: Scenario,
    *,
    read: str,
    overwrite: bool,
    workers: int | None = None,
    driven: tuple[str, ...] = (),
) -> Iterator[tuple["Simulation", WriteMessage]]:
    """A simulation, and what writes its messages to a file, which must not replace the one that was `read`.

    Vehicles that are `driven` wait at their start until they are.

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
        from lidcam.bags.simulator.recorder.stage import true_rig  # OpenCV, which a simulation has loaded by now

        rig = rig_yaml(true_rig(scenario))
        with recording_file(outputs, output, rig_yaml=rig, scenario_yaml=text) as write:
            yield simulation, write
