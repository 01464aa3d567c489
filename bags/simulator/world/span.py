"""Poses of many paths within a short span of time, sampled once and interpolated."""

from typing import NamedTuple

import numpy as np

from lidcam.bags.simulator.world.motion import Path, Poses
from lidcam.bags.simulator.world.rays import Rays
from lidcam.pipeline.core.arrays import F64, I64

SAMPLE_NS = 2_000_000
"""Motion is taken as linear for this long: at 10 rad/s that is right to 0.05 mm at a distance of one metre."""


class Span:
    """The poses of paths within a span of time, sampled when first asked for."""

    def __init__(self, first_ns: int, last_ns: int) -> None:
        steps = -((first_ns - last_ns) // SAMPLE_NS)
        self._first_ns, self._steps = first_ns, steps
        self._step_ns = (last_ns - first_ns) / max(steps, 1)
        self._times_ns = first_ns + np.rint(np.arange(steps + 1) * self._step_ns).astype(np.int64)
        self._samples: dict[int, _Samples] = {}
        self._spheres: dict[tuple[float, ...], tuple[F64, float]] = {}

    @classmethod
    def of(cls, rays: Rays) -> "Span":
        """The span of the times of N > 0 rays."""
        return cls(int(rays.times_ns.min()), int(rays.times_ns.max()))

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
    """A path sampled over a span; holding on to the path keeps its id from being reused.

    Its K poses, also as columns (K, 12), and the change (K - 1, 12) from each to the next.
    """

    path: Path
    poses: Poses
    columns: F64
    changes: F64
