"""What is kept of all frames, one row for each true object and each detection, and which rows a figure is made of."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from pipeline.core.arrays import F32, I32, Bools, Indices, Rows, check_array, select_rows
from pipeline.evaluation.evaluation_frame import Names

__all__ = [
    "FALSE",
    "I16",
    "IGNORED",
    "FoundTable",
    "Labels",
    "Place",
    "Scored",
    "TruthTable",
    "found_in",
    "scored",
    "truth_in",
]

I16 = npt.NDArray[np.int16]

FALSE = -1
"""In place of the row of a true object: the detection shows none."""

IGNORED = -2
"""In place of the row of a true object: the detection is neither right nor wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class TruthTable:
    """The true objects of all frames.

    Attributes:
        frames: (T,) int32, number of the evaluated frame.
        class_ids: (T,) int32, row of the configured classes, or `UNKNOWN`.
        labels: (T,) int32, number of the label.
        range_bins: (T,) int16, row of the ranges.
        zones: (T,) int16, row of the zones; -1 outside of all.
        lidar_points: (T,) int32, or `UNKNOWN`.
        yaws: (T,) float32.
        is_evaluated: (T,) bool; False for what is neither a miss nor an error.
        is_nuscenes: (T,) bool, evaluated in the figures that carry the name of nuScenes.
    """

    frames: I32
    class_ids: I32
    labels: I32
    range_bins: I16
    zones: I16
    lidar_points: I32
    yaws: F32
    is_evaluated: Bools
    is_nuscenes: Bools

    def __post_init__(self) -> None:
        n = len(self.frames)
        check_array("frames", self.frames, (n,), np.int32)
        check_array("class_ids", self.class_ids, (n,), np.int32)
        check_array("labels", self.labels, (n,), np.int32)
        check_array("range_bins", self.range_bins, (n,), np.int16)
        check_array("zones", self.zones, (n,), np.int16)
        check_array("lidar_points", self.lidar_points, (n,), np.int32)
        check_array("yaws", self.yaws, (n,), np.float32)
        check_array("is_evaluated", self.is_evaluated, (n,), np.bool_)
        check_array("is_nuscenes", self.is_nuscenes, (n,), np.bool_)

    def __len__(self) -> int:
        return len(self.frames)


@dataclass(frozen=True, slots=True, eq=False)
class FoundTable:
    """The detections of one source in all frames.

    Attributes:
        frames: (N,) int32, number of the evaluated frame.
        class_ids: (N,) int32, row of the configured classes.
        scores: (N,) float32.
        range_bins: (N,) int16, row of the ranges.
        zones: (N,) int16, row of the zones; -1 outside of all.
        yaws: (N,) float32.
        matches: (K, N) int32 by criterion, row of the true object that the detection shows; or `FALSE`, `IGNORED`.
        mistaken: (N,) int32, row of the true object of another class that a false detection shows; or `FALSE`.
        errors: (E, N, M) float32, errors of the matches of E criteria; NaN without a match.
    """

    frames: I32
    class_ids: I32
    scores: F32
    range_bins: I16
    zones: I16
    yaws: F32
    matches: I32
    mistaken: I32
    errors: F32

    def __post_init__(self) -> None:
        n = len(self.frames)
        check_array("frames", self.frames, (n,), np.int32)
        check_array("class_ids", self.class_ids, (n,), np.int32)
        check_array("scores", self.scores, (n,), np.float32)
        check_array("range_bins", self.range_bins, (n,), np.int16)
        check_array("zones", self.zones, (n,), np.int16)
        check_array("yaws", self.yaws, (n,), np.float32)
        check_array("matches", self.matches, (len(self.matches), n), np.int32)
        check_array("mistaken", self.mistaken, (n,), np.int32)
        check_array("errors", self.errors, (len(self.errors), n, self.errors.shape[-1]), np.float32)

    def __len__(self) -> int:
        return len(self.frames)


class Labels:
    """Numbers of the truth's own names of classes, in the order in which they appear."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """The labels by number."""
        return tuple(self._numbers)

    def numbers(self, labels: Names) -> I32:
        """(T,) int32, the numbers of labels (T,)."""
        names, rows = np.unique(labels, return_inverse=True)
        return np.array([self._numbers.setdefault(str(name), len(self._numbers)) for name in names], np.int32)[rows]


@dataclass(frozen=True, slots=True)
class Place:
    """A part of the site.

    Attributes:
        kind: Whether it is a range or a zone.
        row: Its row among these.
    """

    kind: Literal["ranges", "zones"]
    row: int


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """Detections that count, by falling score.

    Attributes:
        rows: (N,) of the found table.
        truth_rows: (N,) int32, the object that each shows; `FALSE` if none.
        scores: (N,) float32.
        is_right: (N,) bool.
        range_bins: (N,) int16, where a detection counts: at the object that it shows, or else where it is itself.
        zones: (N,) int16.
    """

    rows: Indices
    truth_rows: I32
    scores: F32
    is_right: Bools
    range_bins: I16
    zones: I16

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, rows: Rows) -> "Scored":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)

    def within(self, place: Place | None) -> "Scored":
        """Those of a part of the site."""
        return self if place is None else self.select(_is_in(self.range_bins, self.zones, place))


def scored(found: FoundTable, truth: TruthTable, rows: Indices, criterion_row: int) -> Scored:
    """The detections that count under a criterion.

    Args:
        found: All detections.
        truth: All true objects.
        rows: Detections by falling score.
        criterion_row: Row of the criterion among the matches.
    """
    matches = found.matches[criterion_row, rows]
    rows, matches = rows[matches != IGNORED], matches[matches != IGNORED]
    is_right = matches != FALSE
    range_bins, zones = found.range_bins[rows], found.zones[rows]
    range_bins[is_right] = truth.range_bins[matches[is_right]]
    zones[is_right] = truth.zones[matches[is_right]]
    return Scored(rows, matches, found.scores[rows], is_right, range_bins, zones)


def found_in(found: FoundTable, rows: Indices, place: Place | None) -> Indices:
    """Those of the rows of the found table whose boxes lie in a part of the site."""
    return rows if place is None else rows[_is_in(found.range_bins[rows], found.zones[rows], place)]


def truth_in(truth: TruthTable, is_counted: Bools, place: Place | None) -> Indices:
    """Those of the counted rows of the truth that lie in a part of the site."""
    return np.flatnonzero(is_counted if place is None else is_counted & _is_in(truth.range_bins, truth.zones, place))


def _is_in(range_bins: I16, zones: I16, place: Place) -> Bools:
    column = range_bins if place.kind == "ranges" else zones
    return np.equal(column, place.row)
