"""Static and time-stamped transforms between named frames."""

from bisect import bisect_left, bisect_right
from collections import deque

import numpy as np

from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.poses import interpolate_poses
from lidcam.pipeline.core.geometry.transform import Transform

MAX_LINKS = 1000
"""Longest chain of transforms; a robot has a dozen."""


class TransformTree:
    """A tf buffer: each frame has one parent (REP 105), by a static or a time-stamped transform.

    Time-stamped transforms are kept for `window_ns` only, which bounds the memory for a long recording.
    """

    def __init__(self, window_ns: int = 30_000_000_000) -> None:
        self._window_ns = window_ns
        self._static: dict[str, Transform] = {}
        self._stamped: dict[str, tuple[deque[int], deque[Transform]]] = {}

    def add_static(self, transform: Transform) -> None:
        """Add a T_parent_child valid at all times; it replaces an earlier one of the same child."""
        self._static[transform.src] = transform

    def add(self, stamp_ns: int, transform: Transform) -> None:
        """Add T_parent_child at one time; an equal stamp replaces, one older than the window is dropped."""
        stamps, transforms = self._stamped.setdefault(transform.src, (deque(), deque()))
        if transforms and transforms[-1].dst != transform.dst:
            if stamp_ns < stamps[-1]:  # late, from the former parent
                return
            stamps.clear()  # the frame has a new parent: its former motion is void
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
        """All known frames."""
        edges = list(self._static.values()) + [transforms[-1] for _, transforms in self._stamped.values()]
        return frozenset(name for edge in edges for name in (edge.dst, edge.src))

    def parent(self, frame: str) -> str | None:
        """Parent of a frame; None for a root or an unknown frame."""
        if frame in self._static:
            return self._static[frame].dst
        return self._stamped[frame][1][-1].dst if frame in self._stamped else None

    def is_static(self, frame: str) -> bool:
        """Whether the transform from this frame to its parent is static."""
        return frame in self._static

    def root(self, frame: str) -> str:
        """The last ancestor of `frame`; the frame itself if it has no parent."""
        return self.chain(frame)[-1]

    def lookup(self, dst: str, src: str, stamp_ns: int | None = None) -> Transform:
        """T_dst_src at a time, interpolated between recorded transforms; the newest if `stamp_ns` is None.

        Raises:
            FrameError: no path joins the frames, or a transform on it is unknown at that time.
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
            if len(chain) == MAX_LINKS:
                raise FrameError(f"more than {MAX_LINKS} transforms one after another lead from frame {frame!r}")
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
