"""Gathers what a page shows from the frames of a result, in bounded memory."""

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Figures, SourceBoxes
from lidcam.pipeline.evaluation.road_users import RoadUserTally
from lidcam.writers.report.courses import Courses
from lidcam.writers.report.grid import SparseGrid
from lidcam.writers.report.timeline import Timeline

MAX_PLACES = 4_000
"""Cells of a map of objects without tracks."""


class ReportCollector:
    """An evaluator whose outcome is drawn: it has no figures.

    Attributes:
        frames: Number of frames.
        first_ns: Stamp of the first one.
        last_ns: Stamp of the last one.
        objects: Objects by class name, summed over the frames.
        users: Road users, each track once.
        courses: Their ways, in the frame that does not move.
        places: Where objects without tracks were, by class name.
        time: By step: `CLASS PLACE` sums of objects, `skew` the largest one (ms).
        sensors: By step: `TOPIC` frames with a message of it.
        log_times_ns: Log time of each frame; 0 where it is not known.
        way: The way of the site frame itself, as track 0.
        poses_known: Frames in which it is known where the site frame stood.
        travelled_m: How far the site frame has gone.
        is_tracked: Whether there are tracks.

    Args:
        config: Classes.
        rig: Zones.
        is_adrift: The sensors move, and where to is not known: ways are as seen from the sensors.
    """

    def __init__(self, config: Config, rig: Rig, *, is_adrift: bool = False) -> None:
        self._names, self._rig, self._is_adrift = config.class_names, rig, is_adrift
        self.frames, self.first_ns, self.last_ns = 0, 0, 0
        self.objects = dict.fromkeys(config.class_names, 0)
        self.users, self.courses = RoadUserTally(config, rig), Courses()
        self.time, self.sensors = Timeline(), Timeline()
        self.places: dict[str, SparseGrid] = {}
        self.log_times_ns: list[int] = []
        self.way = Courses()
        self.poses_known, self.travelled_m = 0, 0.0
        self.is_tracked = False
        self._last_xy: F64 | None = None

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame; they come in order."""
        if not self.frames:
            self.first_ns = frame.stamp_ns
        self.frames, self.last_ns = self.frames + 1, frame.stamp_ns
        time_s = (frame.stamp_ns - self.first_ns) / 1e9
        sums: dict[str, float] = {}
        if (source := frame.sources.get("fused")) is not None:
            self._count(source, sums)
            self._draw(source, frame, time_s)
        self.log_times_ns.append(0 if frame.sync is None else frame.sync.log_time_ns)
        maxima = {} if frame.skew_ns is None else {"skew": frame.skew_ns / 1e6}
        if frame.sync is not None:
            self.sensors.add_frame(time_s, dict.fromkeys(frame.sync.offsets_ns, 1.0), {})
        self.time.add_frame(time_s, sums, maxima)

    def figures(self) -> Figures:
        """None."""
        return {}

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return (self.last_ns - self.first_ns) / 1e9

    def _count(self, source: SourceBoxes, sums: dict[str, float]) -> None:
        places = self._rig.place_rows(source.boxes.centers).tolist()
        for class_id, row in zip(source.boxes.class_ids.tolist(), places, strict=True):
            key = f"{self._names[class_id]} {self._rig.place_names[row]}"
            sums[key] = sums.get(key, 0.0) + 1
            self.objects[self._names[class_id]] += 1

    def _draw(self, source: SourceBoxes, frame: EvaluationFrame, time_s: float) -> None:
        boxes, motion = source.boxes, source.motion
        T_fixed_site = np.eye(4) if self._is_adrift else frame.T_fixed_site
        if T_fixed_site is None:
            return
        self.poses_known += 1
        self._travel(time_s, T_fixed_site[:2, 3])
        xy = (boxes.centers @ T_fixed_site[:3, :3].T + T_fixed_site[:3, 3])[:, :2]
        if motion is None:
            for class_id in np.unique(boxes.class_ids).tolist():
                grid = self.places.setdefault(self._names[class_id], SparseGrid(0.05, MAX_PLACES))
                grid.add_points(xy[boxes.class_ids == class_id])
            return
        self.is_tracked = True
        speeds = np.hypot(motion.velocities[:, 0], motion.velocities[:, 1])
        rows = np.flatnonzero(source.track_ids > NO_TRACK)
        numbers = source.track_ids[rows]
        self.users.add_objects(frame.stamp_ns, boxes.class_ids[rows], boxes.centers[rows], numbers, speeds[rows])
        rows = rows[np.isfinite(speeds[rows])]
        self.courses.add_frame(time_s, source.track_ids[rows], xy[rows], speeds[rows])

    def _travel(self, time_s: float, xy: F64) -> None:
        self.way.add_frame(time_s, np.zeros(1, np.int64), xy[None], np.zeros(1))
        if self._last_xy is None:
            self._last_xy = xy
        step_m = float(np.hypot(*(xy - self._last_xy)))
        if step_m > 0.05:  # what a rig that stands seems to move is noise
            self.travelled_m += step_m
            self._last_xy = xy
