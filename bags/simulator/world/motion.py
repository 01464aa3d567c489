"""Poses as arrays, paths that give them for any time, states over time, and moving things: parts on paths."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from lidcam.bags.simulator.world.mesh import Mesh
from lidcam.pipeline.core.arrays import F64, I64, Table
from lidcam.pipeline.core.geometry.transform import Transform

Vector = tuple[float, float, float]

SAMPLE_NS = 2_000_000  # time over which motion is taken as linear: at 10 rad/s right to 0.05 mm at one metre
T_BODY_OPTICAL = Transform("body", "optical", np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]))
"""From a camera's optical axes (x right, y down, z forward) to those of its body (x forward, y left, z up); REP 103."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses(Table):
    """N rigid transforms from the frame of a thing to the world."""

    rotation: F64  # (N, 3, 3)
    translation: F64  # (N, 3) metres

    def __matmul__(self, other: "Poses") -> "Poses":
        """Composition, `other` first; a single pose on either side applies to all of the other."""
        return Poses(self.rotation @ other.rotation, self.apply(other.translation))

    def inverse(self) -> "Poses":
        """The inverse transforms."""
        rotation = self.rotation.transpose(0, 2, 1)
        return Poses(rotation, -turned(rotation, self.translation))

    def apply(self, points: F64) -> F64:
        """Points (N, 3) in the world, each transformed by its own pose, or all by a single one."""
        return turned(self.rotation, points) + self.translation


class Path(Protocol):
    """The pose of a thing at any simulated time."""

    def poses(self, times_ns: I64) -> Poses:
        """Poses (N) at times (N,) in nanoseconds since the start of the scenario."""


@dataclass(frozen=True, slots=True)
class FixedPath:
    """The path of a static thing."""

    T_world_thing: Transform

    def poses(self, times_ns: I64) -> Poses:
        """The same pose N times."""
        matrix, n = self.T_world_thing.matrix, len(times_ns)
        return Poses(np.tile(matrix[:3, :3], (n, 1, 1)), np.tile(matrix[:3, 3], (n, 1)))


@dataclass(frozen=True, slots=True)
class MountedPath:
    """The path of a thing with a fixed pose on a moving carrier."""

    carrier: Path
    T_carrier_thing: Transform

    def poses(self, times_ns: I64) -> Poses:
        """The carrier's poses times the fixed one."""
        matrix = self.T_carrier_thing.matrix
        return self.carrier.poses(times_ns) @ Poses(matrix[None, :3, :3], matrix[None, :3, 3])


def turned(rotation: F64, vectors: F64) -> F64:
    """Vectors (N, 3) times rotations (N, 3, 3); either may be a single one (1, ...) for all of the other."""
    if len(rotation) == 1:
        # Not BLAS: on a busy machine its threads wait for one another.
        x, y, z = vectors.T
        result = np.empty_like(vectors)
        for axis, (a, b, c) in enumerate(rotation[0]):
            result[:, axis] = a * x + b * y + c * z
        return result
    if len(vectors) == 1:
        return np.asarray(np.einsum("nij,j->ni", rotation, vectors[0]))
    return np.asarray(np.einsum("nij,nj->ni", rotation, vectors))


def upright_poses(positions: F64, yaws: F64) -> Poses:
    """Poses of upright things at positions (N, 3), metres, turned by yaws (N,), radians about +z."""
    cos, sin, zero, one = np.cos(yaws), np.sin(yaws), np.zeros_like(yaws), np.ones_like(yaws)
    rotation = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], -1).reshape(-1, 3, 3)
    return Poses(rotation, np.asarray(positions, np.float64))


class Span:
    """The poses of paths within the span of some times (N > 0), sampled when first asked for and interpolated."""

    def __init__(self, times_ns: I64) -> None:
        first_ns, last_ns = int(times_ns.min()), int(times_ns.max())
        steps = -((first_ns - last_ns) // SAMPLE_NS)
        self._first_ns, self._steps = first_ns, steps
        self._step_ns = (last_ns - first_ns) / max(steps, 1)
        self._times_ns = first_ns + np.rint(np.arange(steps + 1) * self._step_ns).astype(np.int64)
        self._samples: dict[int, _Samples] = {}
        self._spheres: dict[tuple[float, ...], tuple[F64, float]] = {}

    def poses(self, path: Path, times_ns: I64) -> Poses:
        """One pose for each of the times (N,), or a single one if the span is one instant."""
        samples = self._sampled(path)
        if not self._steps:
            return samples.poses
        at = (times_ns - self._first_ns) / self._step_ns
        before = np.minimum(at.astype(np.int64), self._steps - 1)
        share = (at - before)[:, None]
        placed = samples.columns.take(before, 0) + share * samples.changes.take(before, 0)
        return Poses(placed[:, :9].reshape(-1, 3, 3), placed[:, 9:])

    def sphere(self, path: Path, point: F64) -> tuple[F64, float]:
        """Centre and radius of a sphere that holds a point (3,) of something throughout the span."""
        key = id(path), *point.tolist()
        if key not in self._spheres:
            poses = self._sampled(path).poses
            places = poses.rotation @ point + poses.translation
            middle = places.sum(0) / len(places)
            self._spheres[key] = middle, float(np.sqrt(((places - middle) ** 2).sum(1).max()))
        return self._spheres[key]

    def _sampled(self, path: Path) -> "_Samples":
        if id(path) not in self._samples:
            poses = path.poses(self._times_ns)
            columns = np.concatenate([poses.rotation.reshape(-1, 9), poses.translation], axis=1)
            self._samples[id(path)] = _Samples(path, poses, columns, np.diff(columns, axis=0))
        return self._samples[id(path)]


class _Samples(NamedTuple):
    """A path sampled over a span."""

    path: Path  # held so that its id is not used again
    poses: Poses  # (K)
    columns: F64  # (K, 12) rotation and translation
    changes: F64  # (K - 1, 12) from each to the next


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A rigid part of a mover."""

    mesh: Mesh  # in the part's own frame
    path: Path  # of that frame


class UprightBox(NamedTuple):
    """An upright box in the base frame of a mover."""

    center_m: Vector
    size_m: Vector  # length, width, height


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A moving thing and its ground truth box."""

    name: str  # unique in the scenario
    class_name: str  # ground truth class (`car`, `truck`, `bus`, `cyclist`, `pedestrian`...)
    path: Path  # of its base frame: on the ground, x forward
    box_center_m: Vector  # centre of a box that holds it at all times, in the base frame
    size_m: Vector  # length, width, height of that box; no part sticks out of it by more than a centimetre
    parts: tuple[Part, ...]
    body: UprightBox | None  # ground truth box, without mirrors; None for people: the smallest one at each moment

    def body_at(self, time_ns: int) -> UprightBox:
        """The ground-truth box at a time."""
        if self.body is not None:
            return self.body
        to_base = self.path.poses(np.array([time_ns], np.int64)).inverse()
        vertices = to_base.apply(np.concatenate([placed_vertices(part, time_ns) for part in self.parts]))
        low, high = vertices.min(0), vertices.max(0)
        (x, y, z), (length, width, height) = ((low + high) / 2).tolist(), (high - low).tolist()
        return UprightBox((x, y, z), (length, width, height))


def placed_vertices(part: Part, time_ns: int) -> F64:
    """The vertices (V, 3) of a part in the world at a time."""
    pose = part.path.poses(np.array([time_ns], np.int64))
    return np.asarray(turned(pose.rotation, part.mesh.vertices) + pose.translation)


SPEED, STEERING, WALKED = 3, 4, 5  # columns of `Trajectory.states`
MIN_ROOM = 256  # of states
STEP_M = np.linspace(-0.24, 0.24, 7)


class Carrier(Path, Protocol):
    """The path of the base frame of an articulated thing: a `Trajectory` or a `RaisedPath`."""

    def states(self, times_ns: I64) -> F64:
        """(N, 6) columns as the fields of `State`, at times (N,)."""


class State(NamedTuple):
    """The state of a vehicle or pedestrian at one time."""

    x_m: float  # of its base frame: below the rear axle, or below the middle of a pedestrian
    y_m: float
    yaw_rad: float  # not wrapped
    speed_m_s: float = 0.0  # along the heading; negative backwards
    steering_rad: float = 0.0  # at the middle of the front axle, positive to the left
    walked_m: float = 0.0  # distance covered, which drives gait and pedalling


class Trajectory:
    """States at rising times, linear in between; a `Carrier`.

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
        """(N, 6) columns as the fields of `State`, at times (N,); raises ValueError if one is after the last state."""
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


@dataclass(frozen=True, slots=True)
class RaisedPath:
    """A path over uneven ground."""

    carrier: Carrier  # the path in the plane z = 0
    height: Callable[[F64], F64]  # from positions (N, 2) to heights (N,) of the ground

    def states(self, times_ns: I64) -> F64:
        """The states of the carrier."""
        return self.carrier.states(times_ns)

    def poses(self, times_ns: I64) -> Poses:
        """Poses (N) on the ground, smoothed over a foot's length at steps."""
        flat = self.carrier.poses(times_ns)
        ahead, raised = flat.rotation[:, :2, 0], flat.translation.copy()
        under = np.concatenate([raised[:, :2] + offset * ahead for offset in STEP_M])
        raised[:, 2] = self.height(under).reshape(len(STEP_M), -1).mean(axis=0)
        return Poses(flat.rotation, raised)


@dataclass(frozen=True, slots=True)
class ArticulatedPath:
    """The path of a part whose pose on its carrier depends on the carrier's state."""

    carrier: Carrier  # path of the whole thing
    place: Callable[[F64], Poses]  # from states (N, 6) to poses (N) of the part in the carrier's base frame
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)  # factors of the carrier's length, width and height

    def poses(self, times_ns: I64) -> Poses:
        """Poses (N) of the part in the world at times (N,)."""
        placed = self.place(self.carrier.states(times_ns))
        return self.carrier.poses(times_ns) @ Poses(placed.rotation, placed.translation * self.scale)


def pitched(angles: F64, x: F64 | float, y: float, z: F64 | float) -> Poses:
    """Poses (N) in the carrier's frame that swing a hanging part forward by angles (N,)."""
    cos, sin, zero, one = np.cos(angles), np.sin(angles), np.zeros_like(angles), np.ones_like(angles)
    rotation = np.stack([cos, zero, -sin, zero, one, zero, sin, zero, cos], -1).reshape(-1, 3, 3)
    return Poses(rotation, np.stack([zero + x, zero + y, zero + z], -1))


def hinged(angles: F64, lean_rad: float, hinge: F64) -> Poses:
    """Poses (N) turned to the left about an axis through `hinge` that leans back from the vertical."""
    axis = np.array([-np.sin(lean_rad), 0.0, np.cos(lean_rad)])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    sin, cos = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    rotation = np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)
    return Poses(rotation, np.repeat(hinge[None], len(angles), 0))
