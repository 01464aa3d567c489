"""A scenario as a stream of messages, simulated step by step.

The messages do not depend on the steps or the number of workers: each measurement depends only on the scenario, the
seed and its own number.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from lidcam.bags.simulator.recorder.messages import Hypothesis, MessageFactory, TrueObject, class_of, counted, seen_by
from lidcam.bags.simulator.recorder.processes import SensingProcess
from lidcam.bags.simulator.recorder.recorded import STEP_NS, Measured, Recorded, SensingTask
from lidcam.bags.simulator.recorder.sensing import Sensing
from lidcam.bags.simulator.recorder.stage import Stage, recorded_extrinsics
from lidcam.bags.simulator.scenario.scenario import EGO_FRAME, command_topic, controller_topics
from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand
from lidcam.bags.simulator.world.bodies.dimensions import shape_of
from lidcam.bags.simulator.world.motion import State
from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.ros.vision_numbers import IMAGE_PIXELS, LIDAR_POINTS

TRUTH_TOPIC = "/ground_truth/objects"
MEASURED_TRUTH_TOPIC = "/ground_truth/objects_when_measured"

LATENCY_NS = 1_000_000  # from a vehicle's state to the recording of its message
TURN_NS = 10_000_000  # interval over which the yaw rate is measured


class StateMessages:
    """The messages that come from no sensor: odometry, tf, commands and ground truth."""

    def __init__(self, stage: Stage, messages: MessageFactory) -> None:
        self._stage, self._messages = stage, messages
        self._lidars = [f"lidars.{name}" for name in stage.scenario.lidars]
        self._cameras = [f"cameras.{name}" for name in stage.scenario.cameras]

    def between(self, begin_ns: int, until_ns: int) -> Iterator[Recorded]:
        """Odometry, tf and commands of all vehicles, at times after `begin_ns` up to `until_ns`."""
        settings = self._stage.scenario.recording
        for name, vehicle in self._stage.scenario.vehicles.items():
            for time_ns in moments(settings.odometry_rate_hz, begin_ns, until_ns):
                if vehicle.ego:
                    yield from self._ego_motion(name, time_ns, odometry=vehicle.odometry)
                elif vehicle.odometry:
                    yield self._message(f"/{name}/base_pose_ground_truth", time_ns, self._odometry(name, time_ns))
            if vehicle.commands:
                for time_ns in moments(settings.command_rate_hz, begin_ns, until_ns):
                    yield from self._commands(name, time_ns)

    def truth(self, time_ns: int, measured: Sequence[Measured]) -> Recorded:
        """The ground truth at one time; the measurements include all that span it."""
        times_ns = [time_ns] * len(self._stage.scene.movers)
        return self._objects(TRUTH_TOPIC, time_ns, times_ns, measured, log_ns=time_ns + self._stage.longest_ns)

    def truth_when_measured(self, time_ns: int, measured: Sequence[Measured]) -> Recorded:
        """The same objects, each at the mean time of its points in sweeps that begin at that time.

        A frame of several lidars has the stamp of the first, and of each other one the sweep that begins nearest to it.
        So the times of points count from the beginning of the first lidar's sweep, and the other sweeps are shifted by
        whole turns until they begin within half a turn of it. The traffic must have advanced beyond the time by twice
        the longest measurement.
        """
        count = len(self._stage.scene.movers)
        sweeps = [one for one in measured if one.sensor in self._lidars and one.from_ns <= time_ns < one.until_ns]
        sweeps.sort(key=lambda one: self._lidars.index(one.sensor))
        points, late_ns = np.zeros(count, np.int64), np.zeros(count, np.int64)
        for one in sweeps:
            turn_ns, after_ns = one.until_ns - one.from_ns, one.from_ns - sweeps[0].from_ns
            after_ns -= (after_ns + turn_ns // 2) // turn_ns * turn_ns
            points += one.hits
            late_ns += one.hit_offsets_ns + after_ns * one.hits
        times_ns = (time_ns + np.rint(late_ns / np.maximum(points, 1)).astype(np.int64)).tolist()
        log_ns = time_ns + 2 * self._stage.longest_ns
        return self._objects(MEASURED_TRUTH_TOPIC, time_ns, times_ns, measured, log_ns=log_ns)

    def _objects(
        self, topic: str, time_ns: int, times_ns: Sequence[int], measured: Iterable[Measured], *, log_ns: int
    ) -> Recorded:
        """All objects, each with the hits of one time and where it is at its own time."""
        stage = self._stage
        hits = {name: np.zeros(len(stage.scene.movers), np.int64) for name in stage.scenario.sensors}
        for one in measured:
            if one.from_ns <= time_ns < one.until_ns:
                hits[one.sensor] += one.hits
        objects = [
            TrueObject(mover.name, row, *stage.body_box(row, times_ns[row]), self._hypotheses(row, hits))
            for row, mover in enumerate(stage.scene.movers)
        ]
        message = self._messages.truth(time_ns, stage.scenario.site_frame, objects)
        return self._messages.recorded(log_ns, topic, time_ns, message)

    def _hypotheses(self, row: int, hits: Mapping[str, I64]) -> tuple[Hypothesis, ...]:
        """Class and counts of a mover, from the hits of each sensor on all movers."""
        totals, shares = [], []
        for kind, names in ((LIDAR_POINTS, self._lidars), (IMAGE_PIXELS, self._cameras)):
            counts = [int(hits[name][row]) for name in names]
            totals.append(counted(kind, sum(counts)))
            sensors = [name.partition(".")[2] for name in names]
            shares += [seen_by(kind, n, name, k) for k, (n, name) in enumerate(zip(counts, sensors, strict=True))]
        return class_of(self._stage.scene.movers[row].class_name), *totals, *shares

    def _message(self, topic: str, time_ns: int, message: Any, *, after: int = 1) -> Recorded:
        return self._messages.recorded(time_ns + after * LATENCY_NS, topic, time_ns, message)

    def _ego_motion(self, name: str, time_ns: int, *, odometry: bool) -> Iterator[Recorded]:
        pose = self._stage.T_site_base(name, EGO_FRAME, time_ns)
        yield self._message("/tf", time_ns, self._messages.transforms(time_ns, [pose]))
        if odometry:
            speed, turn = self._speeds(name, time_ns)
            yield self._message("/odom", time_ns, self._messages.odometry(time_ns, pose, (speed, 0.0, turn)))

    def _odometry(self, name: str, time_ns: int) -> Any:
        """Odometry of the centre of a vehicle's box, as in the predecessor system."""
        vehicle = self._stage.scenario.vehicles[name]
        ahead_m = shape_of(vehicle.shape, vehicle.scale).box_center_m[0]
        speed, turn = self._speeds(name, time_ns)
        pose = self._stage.T_site_box(name, name, time_ns)
        return self._messages.odometry(time_ns, pose, (speed, turn * ahead_m, turn))

    def _speeds(self, name: str, time_ns: int) -> tuple[float, float]:
        """Speed along the heading (m/s), and yaw rate (rad/s)."""
        path = self._stage.traffic.trajectories[name]
        before, now = path.state(max(time_ns - TURN_NS, 0)), path.state(time_ns)
        return now.speed_m_s, (now.yaw_rad - before.yaw_rad) / (TURN_NS * 1e-9)

    def _commands(self, name: str, time_ns: int) -> Iterator[Recorded]:
        """The driver's command, and the six controller commands that follow from it."""
        command = self._stage.traffic.command_at(name, time_ns)
        speed, steering = command.speed_m_s, command.steering_rad
        drive = self._messages.drive(time_ns, name, speed_m_s=speed, steering_rad=steering)
        yield self._message(command_topic(name), time_ns, drive)
        values = self._stage.traffic.chassis[name].controllers(command)
        for topic, value in zip(controller_topics(name), values, strict=True):
            yield self._message(topic, time_ns, self._messages.number(value), after=2)


def moments(rate_hz: float, begin_ns: int, until_ns: int) -> Iterator[int]:
    """Times at a fixed rate after `begin_ns` up to `until_ns`; the first of all is 0."""
    if rate_hz <= 0:
        return
    number = 0 if begin_ns < 0 else int(begin_ns * rate_hz / 1e9)
    while (time_ns := round(number * 1e9 / rate_hz)) <= until_ns:
        if time_ns > begin_ns:
            yield time_ns
        number += 1


class Simulation:
    """A running scenario; `recorder.start.simulating` starts one, with processes for other sensors."""

    def __init__(self, task: SensingTask, others: Sequence[SensingProcess] = ()) -> None:
        self.scenario, self.ros_version = task.scenario, task.ros_version
        self._others = others
        self._stage = Stage(task.scenario, driven=task.driven)
        self._messages = MessageFactory(task.ros_version, task.scenario.start_ns)
        self._states = StateMessages(self._stage, self._messages)
        self._sensing = Sensing(self._stage, task)
        self._now_ns = -1
        static = self._messages.transforms(0, recorded_extrinsics(self.scenario))
        self._waiting: list[Recorded] = [self._messages.recorded(0, "/tf_static", 0, static, latched=True)]
        self._measured: list[Measured] = []
        self._truths: list[tuple[int, int, Callable[[int, list[Measured]], Recorded]]] = []  # see `_record_truths`
        self._commands: dict[str, AckermannCommand] = {}

    @property
    def now_ns(self) -> int:
        """Simulated time."""
        return max(self._now_ns, 0)

    def state(self, vehicle: str) -> State:
        """The current state of a vehicle."""
        return self._stage.traffic.trajectories[vehicle].last

    def command(self, vehicle: str, command: AckermannCommand) -> None:
        """Command a vehicle; it holds until the next command."""
        self._commands[vehicle] = command

    def run(self, duration_s: float) -> Iterator[list[Recorded]]:
        """The messages of a whole recording, step by step, in the order of recording."""
        end_ns = round(duration_s * 1e9)
        while self._now_ns < end_ns:
            yield self.step(min(self.now_ns + STEP_NS, end_ns))
        yield self.finish()

    def step(self, until_ns: int) -> list[Recorded]:
        """Advance to a time; returns the messages recorded until then."""
        begin_ns, self._now_ns = self._now_ns, until_ns
        self._measure(until_ns, start_limit_ns=until_ns)
        self._waiting += self._states.between(begin_ns, until_ns)
        for time_ns in moments(self.scenario.recording.truth_rate_hz, begin_ns, until_ns):
            self._truths += [(time_ns, 1, self._states.truth), (time_ns, 2, self._states.truth_when_measured)]
        self._record_truths(until_ns)
        self._stage.forget(until_ns)
        self._measured = [one for one in self._measured if one.until_ns > until_ns - 3 * self._stage.longest_ns]
        self._waiting.sort(key=lambda recorded: recorded[:3])
        ready = sum(recorded.log_ns <= until_ns for recorded in self._waiting)
        done, self._waiting = self._waiting[:ready], self._waiting[ready:]
        return done

    def finish(self) -> list[Recorded]:
        """End the simulation; returns the messages not yet recorded, of all measurements that have started."""
        end_ns = self._now_ns + self._stage.longest_ns
        self._measure(end_ns, start_limit_ns=self._now_ns)
        self._truths = [one for one in self._truths if one[0] < self._now_ns]  # nothing measures at the end itself
        end_ns += self._stage.longest_ns
        self._stage.traffic.advance(end_ns)
        self._record_truths(end_ns)
        done, self._waiting = sorted(self._waiting, key=lambda recorded: recorded[:3]), []
        return done

    def _measure(self, until_ns: int, *, start_limit_ns: int) -> None:
        """Advance traffic and sensors to a time."""
        commands, self._commands = self._commands, {}
        for process in self._others:
            process.ask(until_ns, commands, start_limit_ns=start_limit_ns)
        for name, command in commands.items():
            self._stage.traffic.command(name, command)
        self._stage.traffic.advance(until_ns)
        measured = self._sensing.measure(until_ns, start_limit_ns=start_limit_ns)
        for process in self._others:
            measured += process.answer()
        self._measured += measured
        self._waiting += [recorded for one in measured for recorded in one.recorded]

    def _record_truths(self, until_ns: int) -> None:
        """Record the ground truth of times at which all measurements are complete, one or two of the longest later."""
        pending, self._truths = self._truths, []
        for time_ns, measurements, truth in pending:
            if time_ns + measurements * self._stage.longest_ns > until_ns:
                self._truths.append((time_ns, measurements, truth))
            else:
                self._waiting.append(truth(time_ns, self._measured))
