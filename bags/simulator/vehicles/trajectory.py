"""Trajectories: states over time, appended step by step and interpolated."""

from typing import NamedTuple

import numpy as np

from lidcam.bags.simulator.world.motion import Poses, upright_poses
from lidcam.pipeline.core.arrays import F64, I64

MIN_ROOM = 256


class State(NamedTuple):
    """The state of a vehicle or pedestrian at one time."""

    x_m: float  # of its base frame: below the rear axle, or below the middle of a pedestrian
    y_m: float
    yaw_rad: float  # not wrapped
    speed_m_s: float = 0.0  # along the heading; negative backwards
    steering_rad: float = 0.0  # at the middle of the front axle, positive to the left
    walked_m: float = 0.0  # distance covered, which drives gait and pedalling


class Trajectory:
    """States at rising times, linear in between; a `lidcam.bags.simulator.world.motion.Path`.

    Before its first state it is at rest there; times after its last state are refused.
    """

    def __init__(self, time_ns: int, state: State) -> None:
        self._times = np.empty(MIN_ROOM, np.int64)
        self._states = np.empty((MIN_ROOM, 6), np.float64)
        self._count = 0
        self.append(time_ns, state)

    def append(self, time_ns: int, state: State) -> None:
        """Append a state, later than the last one."""
        if self._count == len(self._times):
            self._times = np.concatenate([self._times, np.empty_like(self._times)])
            self._states = np.concatenate([self._states, np.empty_like(self._states)])
        self._times[self._count] = time_ns
        self._states[self._count] = state
        self._count += 1

    def forget(self, before_ns: int) -> None:
        """Drop states that times from `before_ns` on do not need."""
        first = max(int(np.searchsorted(self._times[: self._count], before_ns, side="right")) - 1, 0)
        kept = self._count - first
        self._times[:kept] = self._times[first : self._count].copy()
        self._states[:kept] = self._states[first : self._count].copy()
        self._count = kept

    @property
    def last(self) -> State:
        """The last state."""
        return State(*self._states[self._count - 1].tolist())

    def states(self, times_ns: I64) -> F64:
        """(N, 6) columns as the fields of `State`, at times (N,).

        Raises:
            ValueError: a time is later than the last state.
        """
        times = self._times[: self._count]
        if len(times_ns) and times_ns.max() > times[-1]:
            raise ValueError(f"expected times up to {times[-1]} ns, got {times_ns.max()}: simulate further first")
        states = self._states[: self._count]
        after = np.clip(np.searchsorted(times, times_ns, side="right"), 1, max(self._count - 1, 1))
        if self._count == 1:
            return np.repeat(states, len(times_ns), 0)
        span = (times[after] - times[after - 1]).astype(np.float64)
        share = np.clip((times_ns - times[after - 1]) / span, 0.0, 1.0)[:, None]
        return np.asarray(states[after - 1] + share * (states[after] - states[after - 1]))

    def state(self, time_ns: int) -> State:
        """The state at one time; see `states`."""
        return State(*self.states(np.array([time_ns], np.int64))[0].tolist())

    def poses(self, times_ns: I64) -> Poses:
        """Poses (N) of the base frame, on the ground (z = 0), at times (N,); see `states`."""
        states = self.states(times_ns)
        return upright_poses(np.c_[states[:, :2], np.zeros(len(states))], states[:, 2])
