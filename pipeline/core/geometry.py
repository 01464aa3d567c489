"""Rigid transforms between named frames, the tree of them over time, and oriented boxes.

`T_dst_src` maps points of frame `src` to frame `dst`; chains read `T_site_base @ T_base_lidar`. Frames follow REP 103
(x forward, y left, z up; camera optical frames z forward, x right, y down).
"""

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from pipeline.core.errors import FrameError

__all__ = [
    "Transform",
    "TransformTree",
    "box_corners",
    "first_polygon_with",
    "interpolate_poses",
    "iou_xyxy",
    "rotation_fault",
    "wrap_angle",
]

F64 = npt.NDArray[np.float64]

MOST_LINKS = 1000
"""Transforms one after another: a robot has a dozen."""

ROTATION_TOLERANCE = 1e-3
"""Largest entry of R R^T - I that still counts as rounding: calibration files often carry three or four digits."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """A rigid motion from one named frame to another.

    Attributes:
        dst: Frame of the points that come out.
        src: Frame of the points that go in.
        matrix: (4, 4) float64, homogeneous; read-only.
    """

    dst: str
    src: str
    matrix: F64

    def __post_init__(self) -> None:
        if self.matrix.shape != (4, 4) or self.matrix.dtype != np.float64:
            raise ValueError(f"matrix: expected float64[4, 4], got {self.matrix.dtype}{list(self.matrix.shape)}")
        self.matrix.flags.writeable = False

    def __matmul__(self, other: "Transform") -> "Transform":
        """Chain two transforms.

        Raises:
            FrameError: the inner frames differ.
        """
        if self.src != other.dst:
            raise FrameError(f"cannot chain {self.dst}<-{self.src} with {other.dst}<-{other.src}: inner frames differ")
        return Transform(self.dst, other.src, self.matrix @ other.matrix)

    def inverse(self) -> "Transform":
        """The transform back."""
        rotation = self.matrix[:3, :3].T
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = -rotation @ self.matrix[:3, 3]
        return Transform(self.src, self.dst, matrix)

    def apply(self, points: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Points (..., 3) of `src` in `dst`; the dtype is kept."""
        # Not BLAS: for products this thin its threads cost tens of milliseconds of waiting on a busy machine.
        x, y, z = np.moveaxis(points, -1, 0)
        moved = np.empty_like(points)
        for axis, (a, b, c, shift) in enumerate(self.matrix[:3].astype(points.dtype)):
            moved[..., axis] = a * x + b * y + c * z + shift
        return moved

    @property
    def translation(self) -> F64:
        """(3,) origin of `src` seen in `dst`, metres."""
        return self.matrix[:3, 3]

    @property
    def quaternion_xyzw(self) -> F64:
        """(4,) unit quaternion x, y, z, w with w >= 0."""
        return Rotation.from_matrix(self.matrix[:3, :3]).as_quat(canonical=True)

    @classmethod
    def identity(cls, dst: str, src: str) -> "Transform":
        """Two names for one place."""
        return cls(dst, src, np.eye(4))

    @classmethod
    def from_quaternion(cls, dst: str, src: str, translation: npt.ArrayLike, xyzw: npt.ArrayLike) -> "Transform":
        """From a translation (3,) in metres and a quaternion x, y, z, w of any positive length.

        Raises:
            FrameError: the quaternion has no length, or a number is not finite.
        """
        quaternion, shift = np.asarray(xyzw, np.float64), np.asarray(translation, np.float64)
        norm = float(np.linalg.norm(quaternion))
        if not (np.isfinite(norm) and norm > 1e-6 and np.isfinite(shift).all()):
            raise FrameError(
                f"transform {dst}<-{src}: expected a unit quaternion and finite metres, "
                f"got {quaternion.tolist()} and {shift.tolist()}"
            )
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
        matrix[:3, 3] = shift
        return cls(dst, src, matrix)


def rotation_fault(rotation: F64) -> str | None:
    """What keeps a (3, 3) matrix from being a rotation, in words; None if it is one."""
    if not np.isfinite(rotation).all():
        return "it holds numbers that are not finite"
    determinant = float(np.linalg.det(rotation))
    if abs(determinant) < 1e-9:
        return "it is singular (determinant 0)"
    deviation = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if deviation > ROTATION_TOLERANCE:
        return f"its rows are not orthonormal (off by {deviation:.3g})"
    if determinant < 0:
        return "it is a reflection (determinant -1): one axis is flipped"
    return None


def wrap_angle(angles_rad: npt.ArrayLike) -> F64:
    """Angles brought to (-pi, pi]."""
    angles = np.asarray(angles_rad, np.float64)
    wrapped = angles - 2 * np.pi * np.ceil((angles - np.pi) / (2 * np.pi))
    return np.where(wrapped <= -np.pi, np.pi, np.minimum(wrapped, np.pi))  # both ends: rounding may overshoot


def box_corners(centers: F64, sizes: F64, yaws: F64) -> F64:
    """The eight corners of N boxes, (N, 8, 3) metres in the boxes' frame.

        4 ------ 5        corners 0-3 are the bottom, counter-clockwise from front left seen from above:
       /|       /|        0 (+l, +w), 1 (-l, +w), 2 (-l, -w), 3 (+l, -w); 4-7 are above 0-3.
      7 ------ 6 |
      | 0 -----|-1
      |/       |/
      3 ------ 2

    Args:
        centers: (N, 3) box centres.
        sizes: (N, 3) length, width, height.
        yaws: (N,) about +z.
    """
    signs = (
        np.array(
            [
                [1, 1, -1],
                [-1, 1, -1],
                [-1, -1, -1],
                [1, -1, -1],
                [1, 1, 1],
                [-1, 1, 1],
                [-1, -1, 1],
                [1, -1, 1],
            ]
        )
        / 2
    )
    local = signs * sizes[:, None]
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    turned = np.stack(
        [local[..., 0] * cos - local[..., 1] * sin, local[..., 0] * sin + local[..., 1] * cos, local[..., 2]],
        -1,
    )
    return np.asarray(turned + centers[:, None], np.float64)


def first_polygon_with(polygons: Sequence[F64], points: F64) -> npt.NDArray[np.int64]:
    """Which polygon holds each point; a point on an edge is inside, the first polygon wins.

    Args:
        polygons: Each (K, 2) corners in either direction; may be concave.
        points: (N, 2) in the same plane.

    Returns:
        (N,) row in `polygons`, -1 where none holds the point.
    """
    rows = np.full(len(points), -1, np.int64)
    for row, polygon in reversed(list(enumerate(polygons))):
        start, end = polygon, np.roll(polygon, -1, axis=0)
        x, y = points[:, :1], points[:, 1:]
        along = end - start
        # > 0: the point lies left of the edge
        side = along[:, 0] * (y - start[:, 1]) - along[:, 1] * (x - start[:, 0])
        crosses = (start[:, 1] <= y) != (end[:, 1] <= y)
        inside = (crosses & ((side > 0) == (along[:, 1] > 0))).sum(1) % 2 == 1
        low, high = np.minimum(start, end), np.maximum(start, end)
        in_span = (x >= low[:, 0]) & (x <= high[:, 0]) & (y >= low[:, 1]) & (y <= high[:, 1])
        on_edge = ((side == 0) & in_span).any(1)
        rows[inside | on_edge] = row
    return rows


def iou_xyxy(first: npt.NDArray[Any], second: npt.NDArray[Any]) -> F64:
    """Overlap (intersection over union) of upright rectangles, each of N with each of M.

    Args:
        first: (N, 4) left, top, right, bottom.
        second: (M, 4) likewise.

    Returns:
        (N, M) in [0, 1]; 0 where a rectangle is empty, inverted or not finite.
    """
    a, b = np.asarray(first, np.float64)[:, None], np.asarray(second, np.float64)[None]
    with np.errstate(invalid="ignore"):
        extent_a, extent_b = a[..., 2:] - a[..., :2], b[..., 2:] - b[..., :2]
        shared = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    overlap = (shared > 0).all(-1) & (extent_a > 0).all(-1) & (extent_b > 0).all(-1)
    intersection = np.where(overlap, shared.prod(-1), 0.0)
    union = np.where(overlap, extent_a.prod(-1) + extent_b.prod(-1) - intersection, 1.0)
    return np.asarray(intersection / union)


def interpolate_poses(stamps_ns: npt.NDArray[np.int64], poses: F64, wanted_ns: npt.NDArray[np.int64]) -> F64:
    """Poses at the wanted times: positions linear, rotations by slerp; beyond the ends the last motion goes on.

    Args:
        stamps_ns: (S,) strictly increasing, S >= 2.
        poses: (S, 4, 4).
        wanted_ns: (W,) in any order.

    Returns:
        (W, 4, 4).
    """
    # Times relative to the first stamp: float64 seconds of the Unix epoch would only resolve 240 ns.
    start = int(stamps_ns[0])
    known = (stamps_ns - start).astype(np.float64)
    wanted = (wanted_ns - start).astype(np.float64)
    row = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, len(known) - 2)
    share = (wanted - known[row]) / (known[row + 1] - known[row])
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    step = (rotations[row].inv() * rotations[row + 1]).as_rotvec()
    out = np.tile(np.eye(4), (len(wanted), 1, 1))
    out[:, :3, :3] = (rotations[row] * Rotation.from_rotvec(step * share[:, None])).as_matrix()
    out[:, :3, 3] = poses[row, :3, 3] * (1 - share[:, None]) + poses[row + 1, :3, 3] * share[:, None]
    return out


class TransformTree:
    """Static and time-stamped transforms by frame, as tf keeps them (REP 105: each frame has one parent).

    Time-stamped edges are kept for `window_ns` only, so that a long recording needs no more memory than a short one.
    """

    def __init__(self, window_ns: int = 30_000_000_000) -> None:
        self._window_ns = window_ns
        self._static: dict[str, Transform] = {}
        self._stamped: dict[str, tuple[deque[int], deque[Transform]]] = {}

    def add_static(self, transform: Transform) -> None:
        """Add T_parent_child that holds for all time; a later one replaces an earlier one."""
        self._static[transform.src] = transform

    def add(self, stamp_ns: int, transform: Transform) -> None:
        """Add T_parent_child at one time. An equal stamp replaces; one older than the window is not kept."""
        stamps, transforms = self._stamped.setdefault(transform.src, (deque(), deque()))
        if transforms and transforms[-1].dst != transform.dst:
            if stamp_ns < stamps[-1]:  # a late word of the former parent
                return
            stamps.clear()  # the frame has a new parent: the old motion says nothing now
            transforms.clear()
        at = bisect_left(stamps, stamp_ns)
        if at < len(stamps) and stamps[at] == stamp_ns:
            transforms[at] = transform
            return
        stamps.insert(at, stamp_ns)
        transforms.insert(at, transform)
        while stamps[-1] - stamps[0] > self._window_ns:
            stamps.popleft()
            transforms.popleft()

    @property
    def frames(self) -> frozenset[str]:
        """Every frame that is named."""
        edges = list(self._static.values()) + [transforms[-1] for _, transforms in self._stamped.values()]
        return frozenset(name for edge in edges for name in (edge.dst, edge.src))

    @property
    def static_edges(self) -> tuple[Transform, ...]:
        """Static transforms T_parent_child, by child name."""
        return tuple(self._static[child] for child in sorted(self._static))

    def parent(self, frame: str) -> str | None:
        """Parent of a frame; None for a root or an unknown frame."""
        if frame in self._static:
            return self._static[frame].dst
        return self._stamped[frame][1][-1].dst if frame in self._stamped else None

    def is_static(self, frame: str) -> bool:
        """Whether the edge from this frame to its parent holds for all time."""
        return frame in self._static

    def root(self, frame: str) -> str:
        """The end of the chain of parents that starts at `frame`."""
        return self.chain(frame)[-1]

    def lookup(self, dst: str, src: str, stamp_ns: int | None = None) -> Transform:
        """T_dst_src at a time, interpolated between recorded transforms; None asks for the newest.

        Raises:
            FrameError: no path joins the frames, or a moving edge on it is not known at that time.
        """
        up_src, up_dst = self.chain(src), self.chain(dst)
        common = next((frame for frame in up_src if frame in up_dst), None)
        if common is None:
            known = ", ".join(sorted(self.frames)) or "none at all"
            raise FrameError(f"no transform joins frame {src!r} with {dst!r}; frames with a transform: {known}")
        return self._climb(dst, common, stamp_ns).inverse() @ self._climb(src, common, stamp_ns)

    def chain(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root.

        Raises:
            FrameError: the parents run in a circle.
        """
        chain: dict[str, None] = {frame: None}  # in order
        last = frame
        while (parent := self.parent(last)) is not None:
            if parent in chain:
                raise FrameError(f"the transforms run in a circle: {' -> '.join([*chain, parent])}")
            if len(chain) == MOST_LINKS:
                raise FrameError(f"more than {MOST_LINKS} transforms one after another lead from frame {frame!r}")
            chain[parent] = None
            last = parent
        return list(chain)

    def _climb(self, frame: str, ancestor: str, stamp_ns: int | None) -> Transform:
        transform = Transform.identity(frame, frame)
        while transform.dst != ancestor:
            transform = self._edge(transform.dst, stamp_ns) @ transform
        return transform

    def _edge(self, child: str, stamp_ns: int | None) -> Transform:
        if child in self._static:
            return self._static[child]
        stamps, transforms = self._stamped[child]
        if stamp_ns is None:
            return transforms[-1]
        if not stamps[0] <= stamp_ns <= stamps[-1]:
            raise FrameError(
                f"transform of {child!r} is known from {stamps[0]} to {stamps[-1]} ns, wanted at {stamp_ns} ns"
            )
        after = bisect_right(stamps, stamp_ns)
        if after == len(stamps):
            return transforms[-1]
        before = after - 1
        pair = np.stack([transforms[before].matrix, transforms[after].matrix])
        times = np.array([stamps[before], stamps[after]], np.int64)
        matrix = interpolate_poses(times, pair, np.array([stamp_ns], np.int64))[0]
        return Transform(transforms[before].dst, child, matrix)
