"""Writes the points of each tracked object of a run as a file of its own in one folder.

Memory is bounded: what was not seen for a while, or longest where there is too much, is written; if the object comes
back, its file is read and goes on.
"""

import re
from types import TracebackType
from typing import Self

import numpy as np

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.settings.run import OutputConfig
from lidcam.pipeline.tracking.object_clouds import ObjectCloud, points_in_objects, voxel_of
from lidcam.writers.clouds.pcd import PcdFacts, read_pcd, write_pcd
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.transaction import OutputFile

ENDED_NS = 5_000_000_000
"""What was not seen for so long has probably gone."""

LONGEST_LABEL = 40
"""Characters of the name of a class in the name of a file."""


class _Open:
    """The cloud of an object that is in memory.

    Attributes:
        cloud: Its points.
        label: Its class, as far as it can be part of a name.
        size: (3,) float64, its size when it was last seen.
        seen_ns: Frame in which it was.
    """

    def __init__(self, cloud: ObjectCloud) -> None:
        self.cloud, self.label, self.size, self.seen_ns = cloud, "", np.zeros(3), 0


class ObjectCloudsWriter:
    """Writes `track_NUMBER_CLASS.pcd` of each object that the lidars see; a `lidcam.writers.base.ResultWriter`."""

    name = "clouds"

    def __init__(self, output: OutputFile, class_names: tuple[str, ...], config: OutputConfig) -> None:
        self._output, self._config = output, config
        self._labels = [re.sub(r"[^\w.-]", "_", name)[:LONGEST_LABEL] for name in class_names]
        self._open: dict[int, _Open] = {}  # by track, the last seen last

    def __enter__(self) -> Self:
        with output_errors(self._output.path):
            self._output.part.mkdir()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            with output_errors(self._output.path):
                while self._open:
                    self._close_first()

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Add the points of one frame; nothing of it can be unfit."""
        objects, tracks, cloud = result.fused.objects, result.fused.tracks, result.combined.detection_cloud
        if tracks is None:
            return ()
        with output_errors(self._output.path):
            for row, xyz, points, moves in points_in_objects(result.fused, cloud):
                if not len(points):
                    continue
                track, size = int(tracks.ids[row]), objects.sizes[row]
                one = self._opened(track, cloud.stamp_ns, voxel_of(size))
                one.label, one.size, one.seen_ns = self._labels[objects.class_ids[row]], size, cloud.stamp_ns
                times_s = (cloud.stamp_ns - one.cloud.stamp_ns + cloud.time_offset_ns[points].astype(np.int64)) / 1e9
                new = np.column_stack([xyz, cloud.intensity[points], times_s])
                one.cloud.add(new, size, moves=moves, max_points=self._config.object_cloud_points)
                while self._points() > self._config.waiting_cloud_points and len(self._open) > 1:
                    self._close_first()
            while self._open and self._first().seen_ns < cloud.stamp_ns - ENDED_NS:
                self._close_first()
        return ()

    def _opened(self, track: int, stamp_ns: int, voxel_m: float) -> _Open:
        """The cloud of a track, in memory, the last in order."""
        one = self._open.pop(track, None)
        if one is None:
            one = _Open(ObjectCloud(stamp_ns, voxel_m))
            for path in self._output.part.glob(f"{_stem(track)}_*.pcd"):  # one at most
                facts, points = read_pcd(path)
                one = _Open(ObjectCloud(facts.stamp_ns, facts.voxel_m, points))
                path.unlink()  # its class may be another one by now, and so its name
        self._open[track] = one
        return one

    def _points(self) -> int:
        return sum(len(one.cloud.points) for one in self._open.values())

    def _first(self) -> _Open:
        return next(iter(self._open.values()))

    def _close_first(self) -> None:
        """Write the cloud that was not seen for the longest time."""
        track = next(iter(self._open))
        one = self._open.pop(track)
        cloud, size_m = one.cloud, tuple(one.size.tolist())
        facts = PcdFacts(track, one.label, size_m, cloud.stamp_ns, cloud.voxel_m)
        write_pcd(self._output.part / f"{_stem(track)}_{one.label}.pcd", facts, cloud.points)


def _stem(track: int) -> str:
    return f"track_{track:04d}"
