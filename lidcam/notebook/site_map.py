"""The background of a plot of tracks: places of the sensors in each frame, and the surroundings."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.text import brief
from lidcam.readers.results.result import SOURCE_TOPICS, open_result
from lidcam.readers.truth.site import SitePoses
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput, expected_frames
from lidcam.writers.report.grid import FIRST_CELL_M, MAX_CELLS, MAX_CLOUDS, SparseGrid
from lidcam.writers.tables.objects import Objects

MAX_POINTS = 10_000
"""Points of a cloud that go into the map while a run goes on, roughly: they cost 5 ms."""


@dataclass(frozen=True, slots=True, eq=False)
class SiteMap:
    """The frames of a run in a frame that does not move."""

    poses: F64  # (F, 4, 4) float64, T_fixed_site of each frame, metres; NaN where it is not known
    background: SparseGrid  # Where points of the lidars lie
    moves: bool = False  # Whether the sensors moved
    is_adrift: bool = False  # They moved, and nobody recorded where to: the poses are those of the site frame itself

    __repr__ = brief

    def places(self, objects: Objects) -> F64:
        """(N, 2) x and y of the centres of objects in the fixed frame, metres; NaN where it is not known."""
        T_fixed_site = self.poses[objects.frames]
        return np.asarray(
            np.einsum("nij,nj->ni", T_fixed_site[:, :2, :3], objects.centers) + T_fixed_site[:, :2, 3], np.float64
        )

    @property
    def way(self) -> F64:
        """(F, 2) where the origin of the site frame was in each frame, metres."""
        return self.poses[:, :2, 3]


MakeMap = Callable[[], SiteMap]


def no_map() -> SiteMap:
    """Nothing around, and no frames."""
    return SiteMap(np.zeros((0, 4, 4)), SparseGrid(FIRST_CELL_M, MAX_CELLS))


class MapCollector:
    """Gathers the map of a run while it goes on."""

    def __init__(self, source: RunInput) -> None:
        self._site_frame, self._is_recorded = source.rig.site_frame, source.motion is not None
        self._step = max(expected_frames(source) // MAX_CLOUDS, 1)
        self._poses: list[F64] = []
        self._background, self._moves = SparseGrid(FIRST_CELL_M, MAX_CELLS), self._is_recorded

    def add_frame(self, frame: Frame) -> None:
        """Take in one frame; they come in order."""
        pose = frame.bundle.pose_of(self._site_frame) if self._is_recorded else np.eye(4)
        if frame.odometry is not None and not self._is_recorded:
            pose, self._moves = frame.odometry.T_fixed_site, True
        T_fixed_site = np.full((4, 4), np.nan) if pose is None else pose
        self._poses.append(T_fixed_site)
        if len(self._poses) % self._step == self._step // 2 and pose is not None:
            xyz = frame.combined.cloud.xyz
            xyz = xyz[:: max(len(xyz) // MAX_POINTS, 1)].astype(np.float64)
            self._background.add_points(xyz @ T_fixed_site[:2, :3].T + T_fixed_site[:2, 3])

    def site_map(self) -> SiteMap:
        """The map of the frames so far."""
        return SiteMap(np.array(self._poses).reshape(-1, 4, 4), self._background, self._moves)


def read_site_map(path: Path) -> SiteMap:
    """The map of a result; its recorded motion is used, not what the clouds told while it was made."""
    from lidcam.outputs.report.make import background_of  # with rich

    with open_result(path) as result:
        fused = [messages[SOURCE_TOPICS["fused"]] for messages in result.messages_of_frames([SOURCE_TOPICS["fused"]])]
        found = SitePoses([result.recording], result.rig, result.config)
        poses = [found.T_fixed_site(message.stamp_ns) for message in fused]
        matrices = [np.full((4, 4), np.nan) if pose is None else pose.matrix for pose in poses]
        background = background_of(result, () if result.is_adrift else [message.log_time_ns for message in fused])
        T_fixed_site = np.array(matrices).reshape(-1, 4, 4)
        known = T_fixed_site[np.isfinite(T_fixed_site).all((1, 2))]
        moves = result.is_adrift or bool((known != known[:1]).any())
        return SiteMap(T_fixed_site, background, moves, result.is_adrift)
