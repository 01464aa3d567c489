"""Figures of tracks against truth."""

from collections.abc import Sequence
from dataclasses import fields
from typing import TypeVar

from lidcam.pipeline.evaluation.evaluation_frame import Figure, Figures
from lidcam.pipeline.evaluation.tracking.clear import ClearCounts, clear_figures, count_clear, match_clear
from lidcam.pipeline.evaluation.tracking.collect import Collection
from lidcam.pipeline.evaluation.tracking.courses import course_figures, follow, total_courses
from lidcam.pipeline.evaluation.tracking.hota import HotaCounts, count_hota, hota_figures
from lidcam.pipeline.evaluation.tracking.table import TrackTable

Counts = TypeVar("Counts", ClearCounts, HotaCounts)


class TrackingEvaluation(Collection):
    """Tracks of every source that has any, by class and of all classes.

    An object is only compared with boxes of its own class. `all` sums what was counted by class.
    """

    def figures(self) -> Figures:
        """`tracking.SOURCE.CLASS.NAME`; empty without a source that has tracks."""
        return {"tracking": {name: self._source_figures(tables) for name, tables in self.tables()}}

    def _source_figures(self, tables: Sequence[TrackTable]) -> Figures:
        counts = [_Counts(table) for table in tables]
        by_class: dict[str, Figures] = {
            name: {"match_distance_m": table.max_distance_m, **_figures([count])}
            for name, table, count in zip(self._config.class_names, tables, counts, strict=True)
        }
        return {**by_class, "all": {"match_distance_m": None, **_figures(counts)}}


class _Counts:
    """All counts of one class."""

    def __init__(self, table: TrackTable) -> None:
        matches = match_clear(table)
        self.clear = count_clear(table, matches)
        self.hota = count_hota(table)
        self.courses = follow(table, matches)


def _figures(parts: Sequence[_Counts]) -> dict[str, Figure]:
    return {
        **hota_figures(_summed([part.hota for part in parts])),
        **clear_figures(_summed([part.clear for part in parts])),
        **course_figures(total_courses([part.courses for part in parts])),
    }


def _summed(parts: Sequence[Counts]) -> Counts:
    """The counts of all classes together; tracks of different classes have nothing in common."""
    kind = type(parts[0])
    return kind(*(sum(getattr(part, field.name) for part in parts) for field in fields(kind)))
