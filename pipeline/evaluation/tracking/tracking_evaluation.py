"""Figures of tracks against truth."""

from collections.abc import Sequence
from dataclasses import fields
from typing import TypeVar

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Figure, Figures
from lidcam.pipeline.evaluation.scales import range_edges_m, range_names, range_rows
from lidcam.pipeline.evaluation.tracking.clear import (
    ClearCounts,
    IdentityCounts,
    clear_figures,
    count_clear,
    count_identity,
    identity_figures,
    match_clear,
)
from lidcam.pipeline.evaluation.tracking.collect import Collection
from lidcam.pipeline.evaluation.tracking.courses import course_figures, follow, total_courses
from lidcam.pipeline.evaluation.tracking.hota import HotaCounts, count_hota, hota_figures, similarity_of_distance
from lidcam.pipeline.evaluation.tracking.table import TrackTable

Counts = TypeVar("Counts", ClearCounts, HotaCounts, IdentityCounts)


class TrackingEvaluation:
    """Tracks of every source that has any, by class and of all classes.

    An object is only compared with boxes of its own class. `all` sums what was counted by class. Ranges have HOTA,
    CLEAR MOT and IDF1 of their own.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._collection = Collection(config)
        self._edges_m = range_edges_m(config)

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame; one without truth plays no part."""
        self._collection.add_frame(frame)

    def figures(self) -> Figures:
        """`tracking.SOURCE.CLASS.NAME`; empty without a source that has tracks."""
        sources = {name: self._source_figures(tables) for name, tables in self._collection.tables()}
        return {"tracking": sources}

    def _source_figures(self, tables: Sequence[TrackTable]) -> Figures:
        counts = [_Counts(table) for table in tables]
        parts = [self._parts(table, count) for table, count in zip(tables, counts, strict=True)]
        by_class: dict[str, Figures] = {
            name: {
                "match_distance_m": table.max_distance_m,
                **_figures([count]),
                "ranges": self._ranges([[part] for part in of_class]),
            }
            for name, table, count, of_class in zip(self._config.class_names, tables, counts, parts, strict=True)
        }
        ranges = self._ranges(list(zip(*parts, strict=True)))
        return {**by_class, "all": {"match_distance_m": None, **_figures(counts), "ranges": ranges}}

    def _parts(self, table: TrackTable, counts: "_Counts") -> list["_Sums"]:
        """Counts of each range; a box that is matched lies where its object does."""
        matched = table.pairs.select(counts.matches.pairs)
        ranges_m = table.found.ranges_m.copy()
        ranges_m[matched.found] = table.truth.ranges_m[matched.truth]
        true_rows = range_rows(table.truth.ranges_m, self._edges_m)
        found_rows = range_rows(ranges_m, self._edges_m)
        return [_Sums(table.part(true_rows == k, found_rows == k)) for k in range(len(self._edges_m))]

    def _ranges(self, parts: Sequence[Sequence["_Sums"]]) -> Figures:
        """The figures of each range, from the parts of some classes."""
        edges = zip(
            range_names(self._edges_m), self._edges_m.tolist(), [*self._edges_m[1:].tolist(), None], strict=True
        )
        return {
            name: {"from_m": from_m, "to_m": to_m, **_sum_figures(of_classes)}
            for (name, from_m, to_m), of_classes in zip(edges, parts, strict=True)
        }


class _Sums:
    """Counts of a part of the site, or of all of it."""

    def __init__(self, table: TrackTable) -> None:
        self.matches = match_clear(table)
        self.clear = count_clear(table, self.matches)
        self.identity = count_identity(table)
        self.hota = count_hota(table, similarity_of_distance(table))


class _Counts(_Sums):
    """All counts of one class."""

    def __init__(self, table: TrackTable) -> None:
        super().__init__(table)
        self.courses = follow(table, self.matches)
        self.hota_iou = count_hota(table, table.pairs.bev)


def _figures(parts: Sequence[_Counts]) -> dict[str, Figure]:
    by_iou = hota_figures(_summed([part.hota_iou for part in parts]))
    return {
        **_sum_figures(parts),
        **{f"{name}_iou": value for name, value in by_iou.items()},
        **course_figures(total_courses([part.courses for part in parts])),
    }


def _sum_figures(parts: Sequence[_Sums]) -> dict[str, Figure]:
    return {
        **hota_figures(_summed([part.hota for part in parts])),
        **clear_figures(_summed([part.clear for part in parts])),
        **identity_figures(_summed([part.identity for part in parts])),
    }


def _summed(parts: Sequence[Counts]) -> Counts:
    """The counts of all classes together; tracks of different classes have nothing in common."""
    kind = type(parts[0])
    return kind(*(sum(getattr(part, field.name) for part in parts) for field in fields(kind)))
