"""The command `lidcam simulate`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from lidcam.cli.options import Overwrite, RecordingOut, Scenario, Seed, Setting, duration, option, with_log_options
from lidcam.cli.printing.log import remark_log

SIMULATE_EXAMPLES = """\
Scenarios: sandbox, crossing, vehicle, random, or a YAML file of your own.

\b
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
        from lidcam.bags.simulator.scenario.scenario import scenario_file

        typer.echo(scenario_file(name).read_text(encoding="utf-8"), nl=False)
        raise typer.Exit


@with_log_options
def simulate(
    scenario: Scenario,
    output: RecordingOut,
    duration_s: Annotated[
        float | None,
        option("Seconds to record. Default: the scenario's.", "--duration", metavar="S", min=0, callback=duration),
    ] = None,
    seed: Seed = None,
    family: Annotated[
        Literal["sandbox", "crossing", "road"] | None,
        option("Family of worlds that `random` draws from. Default: road."),
    ] = None,
    errors: Annotated[
        bool | None,
        option("Sensors with small errors, or none. Default: errors for `random` only.", "--errors/--exact"),
    ] = None,
    settings: Setting = None,
    overwrite: Overwrite = False,
    shown: Annotated[  # noqa: ARG001, its callback ends the command
        str | None, option("Print a scenario as YAML to copy.", "--show", metavar="NAME", callback=_show, is_eager=True)
    ] = None,
    workers: Annotated[
        int | None, option("Sensors simulated at once; same recording. Default: one per core.", metavar="N", min=1)
    ] = None,
) -> None:
    """Record a simulated scene: lidars, cameras, and ground truth."""
    if family is not None and scenario != "random":
        raise typer.BadParameter(f"expected the scenario random, found {scenario}", param_hint="--family")
    from lidcam.cli.printing.progress import show_progress
    from lidcam.simulation import simulate_recording

    messages, recorded_s = simulate_recording(
        scenario,
        output,
        duration_s=duration_s,
        seed=seed,
        family=family,
        errors=errors,
        settings=settings or (),
        overwrite=overwrite,
        workers=workers,
        show=show_progress,
    )
    log_recording(output, messages, recorded_s)


def log_recording(output: Path, messages: int, recorded_s: float) -> None:
    """Log what was written."""
    size_mib = output.stat().st_size / 2**20
    remark_log.info("wrote %s: %d messages, %.1f s, %.1f MiB", output, messages, recorded_s, size_mib)
