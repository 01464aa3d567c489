"""Road users of a run: how many there were, how fast, and who went from zone to zone. Each track counts once."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Array, Bools
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.core.tracks import MIN_MOVING_SPEED_M_S, NO_TRACK


@dataclass(frozen=True, slots=True)
class RoadUserCount:
    """The road users of one class in one zone, or in all of the site."""

    class_name: str  # Their class
    zone: str  # The zone, `outside` of all zones, or empty: the site
    count: int  # Number of road users that were there for a frame or more
    moved: int  # Number of those that moved, there or elsewhere on the site
    stood: int  # Number of those that never moved, and were slow. The others were seen too briefly to tell
    speed_mean_m_s: float  # Mean, over those that moved, of the mean speed of each while it was there; NaN without any
    speed_max_m_s: float  # Highest speed of one of those in one frame; NaN likewise


@dataclass(frozen=True, slots=True)
class ZoneChange:
    """The road users of one class that were first in one zone and last in another; outside is no zone."""

    class_name: str  # Their class
    from_zone: str  # The first zone in which each was
    to_zone: str  # The last
    count: int  # Number of road users
    speed_mean_m_s: float  # Mean, over those that moved, of the mean speed of each in all frames; NaN without any


@dataclass(frozen=True, slots=True)
class RoadUsers:
    """The road users of a run."""

    counts: tuple[RoadUserCount, ...]  # By class, of each zone where there were any, then of the site
    changes: tuple[ZoneChange, ...]  # By class, by the zone they came from, by the zone they went to

    __repr__ = brief


@dataclass(frozen=True, slots=True, eq=False)
class RoadUserTable:
    """Each road user of a run, in the order in which they came."""

    class_ids: I64  # (N,) int64, row of the configured classes
    # Names of the places: what is outside of all zones (empty where there are none), then the zones
    places: tuple[str, ...]
    frames: I32  # (N, P) int32, frames in which each was in each place
    seconds: F64  # (N, P) float64, how long
    speed_means: F64  # (N,) float64, mean speed of each over all its frames, m/s; NaN where it is not known
    speed_maxima: F64  # (N,) float64, highest speed of each in one frame, m/s; NaN likewise
    first_zones: I32  # (N,) int32, column of the first zone in which each was; 0: it was in none
    last_zones: I32  # (N,) int32, column of the last
    moved: Bools  # (N,) bool, which of them moved in some frame
    stood: Bools  # (N,) bool, which never moved, and were slow in some frame; the others were seen too briefly

    def __len__(self) -> int:
        return len(self.class_ids)


class RoadUserTally:
    """Counts road users while a run goes on; memory grows with their number alone, by about 200 bytes each.

    Objects of no class (`unknown`) are no road users. A track counts as the class of most of its frames; of equals, the
    first of the settings.
    """

    def __init__(self, config: Config, rig: Rig) -> None:
        self._class_names, self._rig = config.class_names, rig
        *zones, outside = rig.place_names
        self._places = [outside, *zones]
        per_class, per_place = (len(config.class_names),), (len(self._places),)
        columns: list[Any] = [
            ("class_frames", np.int32, per_class),
            ("frames", np.int32, per_place),
            ("speed_frames", np.int32, per_place),  # in which the speed is known
            ("speed_sums", np.float64, per_place),
            ("speed_max", np.float64, per_place),
            ("seconds", np.float64, per_place),
            ("first_zone", np.int32),  # rows of the places; 0, outside, until a zone was seen
            ("last_zone", np.int32),
            ("moved", np.bool_),
            ("slow", np.bool_),  # in some frame
        ]
        self._tracks = np.zeros(64, columns)
        self._rows: dict[int, int] = {}  # by number of the track
        self._is_tracked = False
        none = np.zeros(0, np.int64)
        self._before = 0, none, none  # stamp of the last frame, rows of its tracks, and their places

    def add_frame(self, frame: FrameResult) -> None:
        """Count one frame; frames come in order."""
        objects, tracks = frame.fused.objects, frame.fused.tracks
        if tracks is not None:
            stamp_ns, motion = frame.bundle.stamp_ns, (tracks.speeds, tracks.moving)
            self.add_objects(stamp_ns, objects.class_ids, objects.centers, tracks.ids, *motion)

    def add_objects(
        self, stamp_ns: int, class_ids: I32, centers: F64, numbers: I64, speeds: F64, moving: Bools
    ) -> None:
        """Count the N tracked objects of one frame; frames come in order.

        Args:
            stamp_ns: Time of the frame.
            class_ids: (N,) row of the configured classes; one beyond them is of no class.
            centers: (N, 3) metres, in the site frame.
            numbers: (N,) of the tracks, from 1; less: the object belongs to none.
            speeds: (N,) over the ground, m/s; NaN where it is not known.
            moving: (N,) of `Tracks`.
        """
        self._is_tracked = True
        users = ((numbers > NO_TRACK) & (class_ids < len(self._class_names))).nonzero()[0]
        rows = np.array([self._rows.setdefault(track, len(self._rows)) for track in numbers[users].tolist()], np.int64)
        while len(self._tracks) < len(self._rows):
            self._tracks = np.concatenate([self._tracks, np.zeros_like(self._tracks)])
        found, speeds, places = self._tracks, speeds[users], 1 + self._rig.place_rows(centers[users])
        found["class_frames"][rows, class_ids[users]] += 1
        found["frames"][rows, places] += 1
        found["speed_frames"][rows, places] += np.isfinite(speeds)
        found["speed_sums"][rows, places] += np.nan_to_num(speeds)
        found["speed_max"][rows, places] = np.fmax(found["speed_max"][rows, places], speeds)
        found["moved"][rows] |= moving[users]
        found["slow"][rows] |= speeds < MIN_MOVING_SPEED_M_S
        first, last = found["first_zone"][rows], found["last_zone"][rows]
        found["first_zone"][rows] = np.where(first == 0, places, first)
        found["last_zone"][rows] = np.where(places == 0, last, places)
        before_ns, rows_before, places_before = self._before
        stayed = np.isin(rows_before, rows)
        found["seconds"][rows_before[stayed], places_before[stayed]] += max(stamp_ns - before_ns, 0) / 1e9
        self._before = stamp_ns, rows, places

    @property
    def numbers(self) -> tuple[int, ...]:
        """Number of the track of each, in the order of `table`."""
        return tuple(self._rows)

    @property
    def table(self) -> RoadUserTable:
        """The road users so far, one by one; without rows where nothing is tracked."""
        known = self._tracks[: len(self._rows)]
        return RoadUserTable(
            known["class_frames"].argmax(1),
            tuple(self._places),
            known["frames"],
            known["seconds"],
            _mean_speeds(known, [*range(len(self._places))]),
            _max_speeds(known, [*range(len(self._places))]),
            known["first_zone"],
            known["last_zone"],
            known["moved"],
            known["slow"] & ~known["moved"],
        )

    @property
    def road_users(self) -> RoadUsers | None:
        """The road users so far; None where nothing is tracked."""
        if not self._is_tracked:
            return None
        known = self._tracks[: len(self._rows)]
        classes = known["class_frames"].argmax(1)
        by_class = [(name, known[classes == row]) for row, name in enumerate(self._class_names)]
        return RoadUsers(
            tuple(count for name, found in by_class for count in self._counts(name, found)),
            tuple(change for name, found in by_class for change in self._changes(name, found)),
        )

    def _counts(self, class_name: str, found: Array) -> Iterator[RoadUserCount]:
        places = [*range(1, len(self._places)), 0] if len(self._places) > 1 else []
        everywhere = [*range(len(self._places))]
        columns = [(self._places[row], [row]) for row in places] + [("", everywhere)]
        for zone, rows in columns:
            here = found["frames"][:, rows].any(1)
            moved, stood = here & found["moved"], here & found["slow"] & ~found["moved"]
            if here.any():
                means, maxima = _mean_speeds(found[moved], rows), _max_speeds(found[moved], rows)
                yield RoadUserCount(
                    class_name,
                    zone,
                    count=int(here.sum()),
                    moved=int(moved.sum()),
                    stood=int(stood.sum()),
                    speed_mean_m_s=_known(np.mean, means),
                    speed_max_m_s=_known(np.max, maxima),
                )

    def _changes(self, class_name: str, found: Array) -> Iterator[ZoneChange]:
        ways, everywhere = np.stack([found["first_zone"], found["last_zone"]], 1), [*range(len(self._places))]
        for way in np.unique(ways[ways[:, 0] != ways[:, 1]], axis=0):
            went = (ways == way).all(1)
            means = _mean_speeds(found[went & found["moved"]], everywhere)
            first, last = (self._places[row] for row in way.tolist())
            yield ZoneChange(class_name, first, last, int(went.sum()), _known(np.mean, means))


def _mean_speeds(found: Array, places: list[int]) -> F64:
    """(N,) the mean speed of each track in these places; NaN where it is not known."""
    counts = found["speed_frames"][:, places].sum(1)
    means: F64 = np.where(counts > 0, found["speed_sums"][:, places].sum(1) / np.maximum(counts, 1), np.nan)
    return means


def _max_speeds(found: Array, places: list[int]) -> F64:
    """(N,) the highest speed of each track in these places; NaN where it is not known."""
    known = found["speed_frames"][:, places].any(1)
    return np.where(known, found["speed_max"][:, places].max(1), np.nan)


def _known(reduce: Callable[[F64], Any], speeds: F64) -> float:
    """A figure of those that are known; NaN where none is."""
    known = speeds[~np.isnan(speeds)]
    return float(reduce(known)) if len(known) else float("nan")
