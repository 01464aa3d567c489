"""The rows of the tables that a figure is made of: one class, one criterion, everywhere or in a range or a zone."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.core.arrays import F32, I32, Bools, Indices, Rows, select_rows
from pipeline.evaluation.detection.tables import FALSE, I16, IGNORED, FoundTable, TruthTable

__all__ = ["Place", "Scored", "found_in", "scored", "truth_in"]


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
