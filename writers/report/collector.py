"""Gathers what a page shows from the frames of a result, in bounded memory."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Figures, SourceBoxes
from lidcam.pipeline.evaluation.road_users import RoadUserTally
from lidcam.writers.report.grid import SparseGrid

MAX_POINTS = 60_000
"""Corners of all polylines together; of more, each is drawn with fewer."""

FIRST_TOLERANCE_M = 0.01

Corner = tuple[float, float, float, float]
"""x and y in metres, speed in m/s, seconds since the first frame."""


class Courses:
    """Gathers polylines by track: a corner where the track has gone on by more than a tolerance, which grows.

    Attributes:
        tolerance_m: How far apart corners are.
        left_out: Tracks that are not drawn, the shortest, because there are too many.
    """

    def __init__(self) -> None:
        self.tolerance_m, self.left_out = FIRST_TOLERANCE_M, 0
        self._lines: dict[int, list[Corner]] = {}
        self._ends: dict[int, Corner] = {}  # the last place, a corner or not
        self._points = 0
        self._dropped: set[int] = set()

    def add_frame(self, time_s: float, numbers: I64, xy: F64, speeds: F64) -> None:
        """Take in the tracks of one frame: their numbers (N,), places (N, 2) in a fixed frame, and speeds (N,).

        A speed that is not known is NaN.
        """
        for number, (x, y), speed in zip(numbers.tolist(), xy.tolist(), speeds.tolist(), strict=True):
            if number in self._dropped:
                continue
            here = self._ends[number] = (x, y, speed, time_s)
            line = self._lines.setdefault(number, [])
            if not line or _is_apart(here, line[-1], self.tolerance_m):
                line.append(here)
                self._points += 1
        while self._points + len(self._lines) > MAX_POINTS:
            self._simplify()

    def lines(self) -> Iterable[tuple[int, F64]]:
        """Number and (K, 4) corners of each track: x, y in metres, speed in m/s, seconds since the first frame."""
        for number, line in self._lines.items():
            end = self._ends[number]
            yield number, np.array(line if line[-1] == end else [*line, end])

    def _simplify(self) -> None:
        """Draw lines with half the corners; where they have but two each, leave out the shorter half of them."""
        if self._points <= 2 * len(self._lines):
            lengths = {n: np.hypot(*np.subtract(end, self._lines[n][0])[:2]) for n, end in self._ends.items()}
            shortest = sorted(lengths, key=lambda number: (lengths[number], number))[: len(lengths) // 2]
            for number in shortest:
                del self._lines[number], self._ends[number]
            self._dropped.update(shortest)
            self.left_out += len(shortest)
        else:
            self.tolerance_m *= 2
            self._lines = {number: _thinned(line, self.tolerance_m) for number, line in self._lines.items()}
        self._points = sum(map(len, self._lines.values()))


def _is_apart(one: Corner, other: Corner, tolerance_m: float) -> bool:
    return (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2 > tolerance_m**2


def _thinned(line: list[Corner], tolerance_m: float) -> list[Corner]:
    kept = line[:1]
    for corner in line[1:]:
        if _is_apart(corner, kept[-1], tolerance_m):
            kept.append(corner)
    return kept


MAX_STEPS = 480
"""Steps of time on a page; a phone has fewer columns of pixels, a desk has not many more."""

FIRST_STEP_S = 0.1


class Timeline:
    """Sums by name, and largest values, by step of time; where there are too many steps, two become one.

    Attributes:
        step_s: Length of a step.
    """

    def __init__(self) -> None:
        self.step_s, self._last, self._end_s = FIRST_STEP_S, 0, 0.0
        self._frames = np.zeros(MAX_STEPS)
        self._sums: dict[str, F64] = defaultdict(lambda: np.zeros(MAX_STEPS))
        self._largest = np.zeros(MAX_STEPS)

    def add_frame(self, time_s: float, sums: Mapping[str, float], value: float = 0.0) -> None:
        """Take in a frame at a time since the first; one from before it counts as of the first step."""
        while (step := max(int(time_s / self.step_s + 1e-6), 0)) >= MAX_STEPS:  # 0.6 / 0.1 is a little less than 6
            self._double()
        self._last, self._end_s = max(self._last, step), max(self._end_s, time_s)
        self._frames[step] += 1
        for name, number in sums.items():
            self._sums[name][step] += number
        self._largest[step] = max(self._largest[step], value)

    @property
    def edges_s(self) -> F64:
        """(S + 1,) beginnings of the steps up to the last with a frame, and its end, which is that of the frames."""
        edges_s = np.arange(self._last + 2, dtype=np.float64) * self.step_s
        edges_s[-1] = min(edges_s[-1], self._end_s + FIRST_STEP_S)
        return edges_s

    def counts(self) -> F64:
        """(S,) frames in each step."""
        return self._frames[: self._last + 1]

    def sums(self, name: str) -> F64:
        """(S,) sum in each step."""
        return self._sums[name][: self._last + 1]

    def largest(self) -> F64:
        """(S,) largest value in each step; 0 without any."""
        return self._largest[: self._last + 1]

    def at_least(self, step_s: float) -> None:
        """Make steps long enough, for instance so that every one has a frame."""
        while self.step_s < step_s:
            self._double()

    def _double(self) -> None:
        self.step_s *= 2
        self._last //= 2
        for join, of in ((np.sum, (self._frames, *self._sums.values())), (np.max, (self._largest,))):
            for values in of:
                values[:] = np.pad(join(values.reshape(-1, 2), 1), (0, MAX_STEPS // 2))


class Moment(NamedTuple):
    """A frame that is shown as an image."""

    time_s: float  # Since the first frame
    log_time_ns: int
    boxes: Boxes3D  # The fused objects


MAX_PLACES = 4_000
"""Cells of a map of objects without tracks."""


class ReportCollector:
    """An evaluator whose outcome is drawn: it has no figures.

    `is_adrift`: the sensors move, and where to is not known: ways are as seen from the sensors.

    Attributes:
        frames: Number of frames.
        first_ns: Stamp of the first one.
        seconds: Time from frame to frame, without steps back.
        objects: Objects by class name, summed over the frames.
        users: Road users, each track once.
        courses: Their ways, in the frame that does not move.
        places: Where objects without tracks were, by class name.
        time: By step: `CLASS PLACE` sums of objects, `skew` the largest one (ms).
        sensors: By step: `TOPIC` frames with a message of it.
        missed: Names of the sensors that a frame lacks.
        busiest: The frame with most objects, one with images rather than one without, the first of equals; None where
            there are no objects, or the result does not say when its frames were recorded.
        log_times_ns: Log time of each frame; 0 where it is not known.
        way: The way of the site frame itself, as track 0.
        poses_known: Frames in which it is known where the site frame stood.
        travelled_m: How far the site frame has gone.
        is_tracked: Whether there are tracks.
    """

    def __init__(self, config: Config, rig: Rig, *, is_adrift: bool = False) -> None:
        self._names, self._rig, self._is_adrift = config.class_names, rig, is_adrift
        self.frames, self.first_ns, self._last_ns, self.seconds = 0, 0, 0, 0.0
        self.objects = dict.fromkeys(config.class_names, 0)
        self.users, self.courses = RoadUserTally(config, rig), Courses()
        self.time, self.sensors = Timeline(), Timeline()
        self.missed: set[str] = set()
        self.places: dict[str, SparseGrid] = {}
        self.busiest: Moment | None = None
        self._cameras = {camera.topic for camera in rig.cameras if camera.topic}
        self._busy = False, 0
        self.log_times_ns: list[int] = []
        self.way = Courses()
        self.poses_known, self.travelled_m = 0, 0.0
        self.is_tracked = False
        self._last_xy: F64 | None = None

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame; they come in order."""
        if not self.frames:
            self.first_ns = self._last_ns = frame.stamp_ns
        self.seconds += max(frame.stamp_ns - self._last_ns, 0) / 1e9
        self.frames, self._last_ns = self.frames + 1, frame.stamp_ns
        time_s = (frame.stamp_ns - self.first_ns) / 1e9
        sums: dict[str, float] = {}
        if (source := frame.sources.get("fused")) is not None:
            self._count(source, sums)
            self._draw(source, frame, time_s)
            if frame.sync is not None and len(source.boxes):
                busy = not self._cameras.isdisjoint(frame.sync.offsets_ns), len(source.boxes)
                if busy > self._busy:
                    self._busy, self.busiest = busy, Moment(time_s, frame.sync.log_time_ns, source.boxes)
        self.log_times_ns.append(0 if frame.sync is None else frame.sync.log_time_ns)
        if frame.sync is not None:
            self.sensors.add_frame(time_s, dict.fromkeys(frame.sync.offsets_ns, 1.0))
            self.missed.update(frame.sync.missing)
        self.time.add_frame(time_s, sums, (frame.skew_ns or 0) / 1e6)

    def figures(self) -> Figures:
        """None."""
        return {}

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
        seen = boxes.select(rows)
        self.users.add_objects(frame.stamp_ns, seen.class_ids, seen.centers, numbers, speeds[rows], motion.moving[rows])
        self.courses.add_frame(time_s, numbers, xy[rows], speeds[rows])

    def _travel(self, time_s: float, xy: F64) -> None:
        self.way.add_frame(time_s, np.zeros(1, np.int64), xy[None], np.zeros(1))
        if self._last_xy is None:
            self._last_xy = xy
        step_m = float(np.hypot(*(xy - self._last_xy)))
        if step_m > 0.05:  # what a rig that stands seems to move is noise
            self.travelled_m += step_m
            self._last_xy = xy
