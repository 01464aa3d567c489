"""Sensors spread over worker processes, to get around the interpreter lock.

Each process simulates the traffic itself, which is cheap: equal steps and commands give equal traffic. Only commands go
in, and only finished messages come out.
"""

import contextlib
import multiprocessing
import signal
from collections.abc import Mapping, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Self

from lidcam.bags.simulator.recorder.recorded import Measured, SensingTask
from lidcam.bags.simulator.scenario.scenario import Scenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario, LidarScenario
from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand
from lidcam.pipeline.core.ending import undone_at_once
from lidcam.pipeline.core.errors import LidcamError
from lidcam.readers.velodyne.models import MODELS

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
