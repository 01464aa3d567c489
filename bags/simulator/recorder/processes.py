"""Sensors spread over worker processes, to get around the interpreter lock.

Each process simulates the traffic itself, which is cheap: equal steps and commands give equal traffic. Only commands go
in, and only finished messages come out.
"""

import multiprocessing
import os
import signal
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, NamedTuple

from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario, LidarScenario
from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand
from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.ending import undone_at_once
from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.ros.typestores import RosVersion
from lidcam.readers.velodyne.models import MODELS

if TYPE_CHECKING:
    from lidcam.bags.simulator.recorder.simulation import Simulation

STEP_NS = 100_000_000  # default step of a simulation

BEAM_COST_US, PIXEL_COST_US, MOVING_PIXEL_COST_US = 0.8, 0.05, 1.1
"""Rough costs; a moving camera must render everything anew."""

BEAMS_PER_COLUMN = 32  # beams per column of a Velodyne


class SensingTask(NamedTuple):
    """The work of one simulation process."""

    scenario: Scenario
    driven: tuple[str, ...]  # vehicles that wait at their start for commands
    ros_version: RosVersion
    names: tuple[str, ...]  # names of the sensors to simulate


class Recorded(NamedTuple):
    """One serialised message; messages are ordered by the first three fields."""

    log_ns: int  # true time since the scenario began
    topic: str
    stamp_ns: int  # header stamp; `log_ns` for messages without a header
    msgtype: str  # for instance `sensor_msgs/msg/PointCloud2`
    data: bytes  # the message in the encoding of the recording
    latched: bool = False  # late subscribers receive it too


class Measured(NamedTuple):
    """One measurement of a sensor, and the time that it represents."""

    sensor: str  # full name of the sensor, as in `Scenario.sensors`
    from_ns: int
    until_ns: int
    hits: I64  # (M,) points or pixels on each mover
    hit_offsets_ns: I64  # (M,) sum of the times of a mover's points after `from_ns`; 0 for pixels
    recorded: tuple[Recorded, ...]  # empty if the measurement was lost


def shared_out(scenario: Scenario, workers: int) -> list[tuple[str, ...]]:
    """The sensors of each worker: costliest first, each to the worker with the least load."""
    sensors: dict[str, LidarScenario | CameraScenario] = {**scenario.lidars, **scenario.cameras}
    costs = {name: sensor.rate_hz * _cost_us(sensor) for name, sensor in sensors.items()}
    shares: list[list[str]] = [[] for _ in range(max(min(workers, len(costs)), 1))]
    for name in sorted(costs, key=lambda name: -costs[name]):
        min(shares, key=lambda share: sum(costs[other] for other in share)).append(name)
    return [tuple(share) for share in shares]


def _cost_us(sensor: LidarScenario | CameraScenario) -> float:
    """Rough cost of one measurement."""
    if isinstance(sensor, CameraScenario):
        per_pixel = MOVING_PIXEL_COST_US if sensor.mounted_on else PIXEL_COST_US
        return sensor.width_px * sensor.height_px * per_pixel
    beams: float = len(sensor.linear_elevations_deg) * sensor.columns
    if sensor.model != "linear":
        beams = BEAMS_PER_COLUMN / MODELS[sensor.model].column_us * 1e6 / sensor.rate_hz
    return beams / sensor.firing_stride * BEAM_COST_US


class SensingProcess:
    """A worker process with some of the sensors."""

    def __init__(self, task: SensingTask) -> None:
        context = multiprocessing.get_context("spawn")  # threads of the libraries do not survive a fork
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, task), daemon=True)
        resource_tracker.ensure_running()  # else it is started with the process, and unblocks signals
        # A terminal sends Ctrl-C to all processes; only the parent may act on it. A blocked signal stays so in the
        # process, and comes to the parent a little later.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.pid = self.process.pid or 0

    def ask(self, until_ns: int, commands: Mapping[str, AckermannCommand], *, start_limit_ns: int) -> None:
        """Start a step: apply commands, advance to a time and measure; see `Sensing.measure`."""
        try:
            self._pipe.send((until_ns, dict(commands), start_limit_ns))
        except OSError as err:
            raise self._death() from err

    def answer(self) -> Sequence[Measured]:
        """The measurements of the last `ask`.

        Raises:
            LidcamError: the process has died, or failed with an error of its own.
        """
        try:
            answer: Sequence[Measured] | BaseException = self._pipe.recv()
        except (EOFError, OSError) as err:
            raise self._death() from err
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def close(self) -> None:
        """End the process, which ends by itself at end of file."""
        self._pipe.close()
        self.process.join(1.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def _death(self) -> LidcamError:
        self.process.join(1.0)
        code = self.process.exitcode
        return LidcamError(
            f"a simulation process died with exit code {code}, perhaps for lack of memory; try --workers 1"
        )


@contextmanager
def sensing_process(task: SensingTask) -> Iterator[SensingProcess]:
    """A worker process that ends with the block."""
    worker = SensingProcess(task)
    try:
        with undone_at_once(worker.process.kill):  # it may be in a step, or load libraries
            yield worker
    finally:
        worker.close()


def _serve(pipe: Connection, task: SensingTask) -> None:
    """The main loop of a process: requests come in, measurements and errors go out, until the pipe is closed."""
    try:
        from lidcam.bags.simulator.recorder.sensing import Sensing  # Open3D, which this module does without
        from lidcam.bags.simulator.recorder.stage import Stage

        stage = Stage(task.scenario, driven=task.driven)
        sensing = Sensing(stage, task)
        while True:
            until_ns, commands, start_limit_ns = pipe.recv()
            for name, command in commands.items():
                stage.traffic.command(name, command)
            stage.traffic.advance(until_ns)
            pipe.send(sensing.measure(until_ns, start_limit_ns=start_limit_ns))
            stage.forget(until_ns)
    except (EOFError, OSError):
        return
    except Exception as err:
        with suppress(OSError):  # the parent may have failed in the same way
            pipe.send(err)


@contextmanager
def simulating(
    scenario: Scenario, *, ros_version: RosVersion, workers: int | None = None, driven: Collection[str] = ()
) -> Iterator["Simulation"]:
    """A running simulation on `workers` processes, this one among them; None for one per core.

    Workers start first, so that all processes load their libraries in parallel. The vehicles in `driven` wait at their
    start for `Simulation.command`.
    """
    mine, *others = shared_out(scenario, os.cpu_count() or 1 if workers is None else workers)
    with ExitStack() as stack:
        tasks = [SensingTask(scenario, tuple(driven), ros_version, names) for names in others]
        processes = [stack.enter_context(sensing_process(task)) for task in tasks]
        from lidcam.bags.simulator.recorder.simulation import Simulation  # Open3D takes a second or two

        yield Simulation(SensingTask(scenario, tuple(driven), ros_version, mine), processes)
