"""Data sent to and from a simulation process: its task, and measurements with their messages."""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Self

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

STEP_NS = 100_000_000
"""Default step of a simulation."""


class SensingTask(NamedTuple):
    """The work of one simulation process."""

    scenario: Scenario  # The scenario
    driven: tuple[str, ...]  # Vehicles that wait at their start for commands
    ros_version: RosVersion  # ROS version of the messages
    names: tuple[str, ...]  # Names of the sensors to simulate


class Recorded(NamedTuple):
    """One serialised message; messages are ordered by the first three fields."""

    log_ns: int  # True time since the scenario began
    topic: str  # Topic name
    stamp_ns: int  # Header stamp; `log_ns` for messages without a header
    msgtype: str  # Type name, for instance `sensor_msgs/msg/PointCloud2`
    data: bytes  # The message in the encoding of the recording
    latched: bool = False  # Whether late subscribers receive it too


class Measured(NamedTuple):
    """One measurement of a sensor."""

    sensor: str  # Full name of the sensor, as in `Scenario.sensors`
    from_ns: int  # Start of the time that it represents
    until_ns: int  # End of that time
    hits: I64  # (M,) int64 points or pixels on each mover
    hit_offsets_ns: I64  # (M,) int64 sum of the times of a mover's points after `from_ns`; 0 for pixels
    recorded: tuple[Recorded, ...]  # Its messages; empty if it was lost


# DOC Sensors spread over worker processes, to get around the interpreter lock. Each process simulates the traffic itself, which is cheap: equal steps and commands give equal traffic. Only commands go in, and only finished messages come out.


LIDAR_COST = 0.8
CAMERA_COST, MOVING_CAMERA_COST = 0.05, 1.1
"""Microseconds per beam and pixel, roughly; a moving camera must render everything anew."""
SLOTS = 32
"""Beams per column of a Velodyne."""
FROM_TERMINALS = (signal.SIGINT, signal.SIGHUP)


def shared_out(scenario: Scenario, workers: int) -> list[tuple[str, ...]]:
    """The sensors of each worker: costliest first, each to the worker with the least load."""
    sensors: dict[str, LidarScenario | CameraScenario] = {**scenario.lidars, **scenario.cameras}
    costs = {name: sensor.rate_hz * _cost_us(sensor) for name, sensor in sensors.items()}
    shares: list[list[str]] = [[] for _ in range(max(min(workers, len(costs)), 1))]
    for name in sorted(costs, key=lambda name: -costs[name]):
        min(shares, key=lambda share: sum(costs[other] for other in share)).append(name)
    return [tuple(share) for share in shares]


class SensingProcess:
    """A worker process with some of the sensors; a context manager."""

    def __init__(self, task: SensingTask) -> None:
        context = multiprocessing.get_context("spawn")  # threads of the libraries do not survive a fork
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        resource_tracker.ensure_running()  # else it is started with the process, and unblocks signals
        # A terminal sends Ctrl-C to all processes; only the parent may act on it. A blocked signal stays so in the
        # process, and comes to the parent a little later.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_TERMINALS)
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._undoing = contextlib.ExitStack()
        self._undoing.enter_context(undone_at_once(self._process.kill))  # it may be in a step, or load libraries
        theirs.close()
        with contextlib.suppress(OSError):  # it has died, which the first request reports
            self._pipe.send(task)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pipe.close()  # the worker ends at end of file
        self._process.join(1.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._undoing.close()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid or 0

    def ask(self, until_ns: int, commands: Mapping[str, AckermannCommand], *, start_limit_ns: int) -> None:
        """Start a step: apply commands, advance to a time and measure; see `Sensing.measure`."""
        try:
            self._pipe.send((until_ns, dict(commands), start_limit_ns))
        except OSError as err:
            raise self._gone() from err

    def answer(self) -> Sequence[Measured]:
        """The measurements of the last `ask`.

        Raises:
            LidcamError: the process has died, or failed with an error of its own.
        """
        try:
            found = self._pipe.recv()
        except (EOFError, OSError) as err:
            raise self._gone() from err
        if isinstance(found, BaseException):
            raise found
        answer: Sequence[Measured] = found
        return answer

    def _gone(self) -> LidcamError:
        self._process.join(1.0)
        code = self._process.exitcode
        return LidcamError(
            f"a simulation process died with exit code {code}, perhaps for lack of memory; try --workers 1"
        )


def _serve(pipe: Connection) -> None:
    """The main loop of a process: the task comes in, then requests; measurements and errors go out until it closes."""
    try:
        from lidcam.bags.simulator.recorder.sensing import Sensing  # Open3D, which this module does without
        from lidcam.bags.simulator.recorder.stage import Stage

        task: SensingTask = pipe.recv()
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
        with contextlib.suppress(OSError):  # the parent may have failed in the same way
            pipe.send(err)


def _cost_us(sensor: LidarScenario | CameraScenario) -> float:
    """Rough cost of one measurement."""
    if isinstance(sensor, CameraScenario):
        pixels = sensor.width_px * sensor.height_px
        return pixels * (MOVING_CAMERA_COST if sensor.mounted_on else CAMERA_COST)
    beams = (
        len(sensor.linear_elevations_deg) * sensor.columns
        if sensor.model == "linear"
        else SLOTS / MODELS[sensor.model].column_us * 1e6 / sensor.rate_hz
    )
    return beams / sensor.firing_stride * LIDAR_COST


# DOC Starting a simulation: worker processes first, so that all processes load their libraries in parallel.


@contextmanager
def simulating(
    scenario: Scenario,
    *,
    ros_version: RosVersion,
    workers: int | None = None,
    driven: Collection[str] = (),
) -> Iterator["Simulation"]:
    """A running simulation on so many worker processes, this one among them; None for one per core.

    The vehicles in `driven` wait at their start for `Simulation.command`.
    """
    mine, *others = shared_out(scenario, os.cpu_count() or 1 if workers is None else workers)
    with ExitStack() as stack:
        tasks = [SensingTask(scenario, tuple(driven), ros_version, names) for names in others]
        processes = [stack.enter_context(SensingProcess(task)) for task in tasks]
        from lidcam.bags.simulator.recorder.simulation import Simulation  # Open3D takes a second or two

        yield Simulation(SensingTask(scenario, tuple(driven), ros_version, mine), processes)
