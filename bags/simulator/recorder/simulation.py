"""A scenario as a stream of messages, simulated step by step.

The messages do not depend on the steps or the number of workers: each measurement depends only on the scenario, the
seed and its own number.
"""

from collections import deque
from collections.abc import Iterator, Sequence

from lidcam.bags.simulator.recorder.messages import MessageFactory
from lidcam.bags.simulator.recorder.processes import SensingProcess
from lidcam.bags.simulator.recorder.recorded import STEP_NS, Measured, Recorded, SensingTask
from lidcam.bags.simulator.recorder.sensing import Sensing
from lidcam.bags.simulator.recorder.stage import Stage
from lidcam.bags.simulator.recorder.states import States, moments
from lidcam.bags.simulator.recorder.true_rig import recorded_extrinsics
from lidcam.bags.simulator.vehicles.ackermann import AckermannCommand
from lidcam.bags.simulator.vehicles.trajectory import State


class Simulation:
    """A running scenario; `recorder.start.simulating` starts one, with processes for other sensors."""

    def __init__(self, task: SensingTask, others: Sequence[SensingProcess] = ()) -> None:
        self.scenario, self.ros_version = task.scenario, task.ros_version
        self._others = others
        self._stage = Stage(task.scenario, driven=task.driven)
        self._messages = MessageFactory(task.ros_version, task.scenario.start_ns)
        self._states = States(self._stage, self._messages)
        self._sensing = Sensing(self._stage, task)
        self._now_ns = -1
        static = self._messages.transforms(0, recorded_extrinsics(self.scenario))
        self._waiting: list[Recorded] = [self._messages.recorded(0, "/tf_static", 0, static, latched=True)]
        self._measured: list[Measured] = []
        self._truths: deque[int] = deque()
        self._truths_when_measured: deque[int] = deque()
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
        times_ns = list(moments(self.scenario.recording.truth_rate_hz, begin_ns, until_ns))
        self._truths += times_ns
        self._truths_when_measured += times_ns
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
        for times_ns in (self._truths, self._truths_when_measured):
            while times_ns and times_ns[-1] >= self._now_ns:  # no sensor measures at the end itself
                times_ns.pop()
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
        """Record the ground truth of times for which all measurements are complete."""
        longest_ns = self._stage.longest_ns
        while self._truths and self._truths[0] + longest_ns <= until_ns:
            self._waiting.append(self._states.truth(self._truths.popleft(), self._measured))
        while self._truths_when_measured and self._truths_when_measured[0] + 2 * longest_ns <= until_ns:
            time_ns = self._truths_when_measured.popleft()
            self._waiting.append(self._states.truth_when_measured(time_ns, self._measured))
