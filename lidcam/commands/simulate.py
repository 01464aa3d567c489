"""The work of `lidcam simulate`."""

from dataclasses import dataclass

from lidcam.commands.scenario import ScenarioOptions, recording_to, scenario_of
from lidcam.printing.progress import show_progress

__all__ = ["SimulateOptions", "run_simulate"]


@dataclass(frozen=True, slots=True)
class SimulateOptions(ScenarioOptions):
    """The command line of `simulate`.

    Attributes:
        workers: Sensors simulated at once; None: one per core.
    """

    workers: int | None = None


def run_simulate(options: SimulateOptions) -> None:
    """Record a scenario and say what was written.

    Raises:
        LidcamError: the scenario or the output is at fault; no output is left behind.
    """
    scenario = scenario_of(options)
    with (
        recording_to(options, scenario, workers=options.workers) as (simulation, recorder),
        show_progress(scenario.duration_s) as advance,
    ):
        for recorded in simulation.run(scenario.duration_s):
            recorder.add(recorded)
            advance(simulation.now_ns * 1e-9, f"{recorder.messages} messages")
    recorder.tell(options.output, simulation.now_ns)
