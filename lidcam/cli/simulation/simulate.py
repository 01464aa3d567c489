"""The command `lidcam simulate`."""

from importlib.util import find_spec
from typing import Annotated, Literal

import typer

from lidcam.cli.options import Overwrite, RecordingOut, Scenario, Seed, Setting, duration, with_log_options
from lidcam.pipeline.core.errors import LidcamError

RANDOM = "random"
"""Name of the scenarios that are drawn from a seed."""

# \b keeps the lines of a paragraph as they are.
SIMULATE_EXAMPLES = """\b
Scenarios: sandbox, crossing, vehicle, random, or a YAML file of your own.
Examples:
  lidcam simulate sandbox out.bag --duration 10
  lidcam simulate --show sandbox > my.yaml
  lidcam simulate crossing out.mcap --seed 7
  lidcam simulate random out.mcap --family road --seed 7
  lidcam simulate crossing out.mcap --errors
  lidcam simulate sandbox out.bag --set lidars.velodyne1.clock_offset_ms=20
"""


def _show(name: str | None) -> None:
    if name is not None:
        from lidcam.bags.simulator.scenario.load import scenario_file

        typer.echo(scenario_file(name).read_text(encoding="utf-8"), nl=False)
        raise typer.Exit


@with_log_options
def simulate(
    scenario: Scenario,
    output: RecordingOut,
    duration_s: Annotated[
        float | None,
        typer.Option(
            "--duration", min=0, metavar="S", callback=duration, help="Seconds to record. Default: the scenario's."
        ),
    ] = None,
    seed: Seed = None,
    family: Annotated[
        Literal["sandbox", "crossing", "road"] | None,
        typer.Option("--family", help="Family of worlds that `random` draws from. Default: road."),
    ] = None,
    errors: Annotated[
        bool | None,
        typer.Option("--errors/--exact", help="Sensors with small errors, or none. Default: errors for `random` only."),
    ] = None,
    settings: Setting = None,
    overwrite: Overwrite = False,
    shown: Annotated[  # noqa: ARG001, its callback ends the command
        str | None,
        typer.Option("--show", metavar="NAME", callback=_show, is_eager=True, help="Print a scenario as YAML to copy."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Sensors simulated at once; same recording. Default: one per core."),
    ] = None,
) -> None:
    """Record a simulated scene: lidars, cameras, and ground truth."""
    if family is not None and scenario != RANDOM:
        raise typer.BadParameter(f"expected the scenario {RANDOM}, found {scenario}", param_hint="--family")
    check_simulator()
    from lidcam.cli.printing.progress import show_progress
    from lidcam.cli.simulation.scenario import recording_to, scenario_of

    if scenario == RANDOM:
        family = family or "road"
    found = scenario_of(scenario, settings or (), duration_s=duration_s, seed=seed, family=family, errors=errors)
    with (
        recording_to(output, found, read=scenario, overwrite=overwrite, workers=workers) as opened,
        show_progress(found.duration_s) as advance,
    ):
        simulation, recorder = opened
        for recorded in simulation.run(found.duration_s):
            recorder.write_messages(recorded)
            advance(simulation.now_ns * 1e-9, f"{recorder.messages} messages")
    recorder.log_files(output, simulation.now_ns)


def check_simulator() -> None:
    """Check that the extra `sim` and the system libraries that it needs are installed.

    Raises:
        LidcamError: something is missing.
    """
    for package in ("open3d", "libusb_package"):
        if find_spec(package) is None:
            raise LidcamError(f"the simulator needs {package}, which is not installed: pip install 'lidcam[sim]'")
    from lidcam.bags.simulator.world.open3d_runtime import check_libraries

    check_libraries()
