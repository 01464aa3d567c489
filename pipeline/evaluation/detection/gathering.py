"""Frames of a result to the tables that the figures are made of."""

from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import F64, I32, Bools
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.rig import Zone
from pipeline.core.settings.config import Config
from pipeline.core.settings.evaluate import EvaluateConfig
from pipeline.evaluation.detection.criteria import Criteria
from pipeline.evaluation.detection.errors import Column
from pipeline.evaluation.detection.matching import Candidates, match_criteria, match_other_classes
from pipeline.evaluation.detection.near_objects import (
    FoundObjects,
    TrueObjects,
    check_class_ids,
    check_numbers,
    errors_of_pairs,
    pairs_near,
)
from pipeline.evaluation.detection.tables import FALSE, I16, FoundTable, Labels, TruthTable
from pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame
from pipeline.evaluation.ignoring import is_counted, is_evaluated, is_within
from pipeline.evaluation.pieces import Pieces
from pipeline.evaluation.scales import nuscenes_ranges_m, range_edges_m, range_rows

__all__ = ["Gathering"]

_MAX_FRAMES = 128
_MAX_PAIRS = 1 << 18
"""Frames are matched together up to so many of them and up to so many pairs of boxes: memory stays bounded."""

_ERRORS = len(Column)


class Gathering:
    """Matches the 3D boxes of frames with truth, some frames at a time, and keeps what the figures need.

    Args:
        config: Classes and settings of the evaluation.
        zones: Parts of the site.
    """

    def __init__(self, config: Config, zones: Sequence[Zone]) -> None:
        self.labels = Labels()
        self.stamps_ns: list[int] = []
        self.frames_without_truth = 0
        self._settings: EvaluateConfig = config.evaluate
        self._criteria = Criteria.of(config)
        self._edges_m = range_edges_m(config)
        self._polygons = [zone.polygon_site for zone in zones]
        self._class_count = len(config.classes)
        self._nuscenes_m = nuscenes_ranges_m(config)
        self._truth = Pieces(_no_truth())
        self._truth_count = 0
        self._found: dict[str, Pieces[FoundTable]] = {}
        self._waiting: list[EvaluationFrame] = []
        self._waiting_pairs = 0

    def add(self, frame: EvaluationFrame) -> None:
        """Take in one frame.

        Raises:
            ValueError: a class id is none of the configured classes, or a number is not finite.
        """
        rows = self._criteria.distance_rows.stop
        for source in frame.sources:
            if source not in self._found:
                nothing = _no_detections(rows, len(self._criteria.error_rows))
                self._found[source] = Pieces(nothing, by_criterion=("matches", "errors"))
        if frame.truth is None:
            self.frames_without_truth += 1
            return
        self._waiting.append(frame)
        self._waiting_pairs += len(frame.truth) * max((len(source) for source in frame.sources.values()), default=0)
        if len(self._waiting) >= _MAX_FRAMES or self._waiting_pairs >= _MAX_PAIRS:
            self._match()

    def truth(self) -> TruthTable:
        """The true objects so far."""
        self._match()
        return self._truth.table()

    def found(self) -> dict[str, FoundTable]:
        """The detections so far, by source."""
        self._match()
        return {source: pieces.table() for source, pieces in self._found.items()}

    def _match(self) -> None:
        frames, self._waiting, self._waiting_pairs = self._waiting, [], 0
        if not frames:
            return
        first = len(self.stamps_ns)
        self.stamps_ns.extend(frame.stamp_ns for frame in frames)
        truth = TrueObjects.of([frame.truth for frame in frames if frame.truth is not None], first)
        check_numbers("truth", truth.centers, truth.sizes, truth.yaws)
        check_class_ids("truth", truth.class_ids, range(UNKNOWN, self._class_count))
        table = self._truth_table(truth)
        for source, pieces in self._found.items():
            found = FoundObjects.of([frame.sources.get(source) for frame in frames], first)
            check_numbers(source, found.centers, found.sizes, found.scores)
            check_class_ids(source, found.class_ids, range(self._class_count))
            pieces.append(self._found_table(found, truth, table))
        self._truth.append(table)
        self._truth_count += len(truth)

    def _truth_table(self, truth: TrueObjects) -> TruthTable:
        ranges_m = np.append(self._nuscenes_m, 0.0)[truth.class_ids]
        return TruthTable(
            truth.frames,
            truth.class_ids,
            self.labels.numbers(truth.labels),
            *self._places(truth.centers),
            truth.lidar_points,
            truth.yaws.astype(np.float32),
            is_evaluated(truth, self._settings),
            is_counted(truth, self._settings) & (truth.lidar_points != 0) & (_ranges(truth.centers) < ranges_m),
        )

    def _found_table(self, found: FoundObjects, truth: TrueObjects, table: TruthTable) -> FoundTable:
        pairs = pairs_near(found, truth, self._criteria.scales)
        is_outside = ~is_within(found.centers, self._settings)
        own = [*self._criteria.by_overlap, *self._criteria.by_distance]
        matches = match_criteria(
            pairs,
            own,
            position=self._criteria.position,
            found_ids=found.class_ids,
            truth_ids=truth.class_ids,
            scores=found.scores,
            is_evaluated=table.is_evaluated,
            is_ignored=is_outside,
        )
        mistaken = match_other_classes(
            pairs,
            self._criteria.position,
            matches=matches[self._criteria.position_row],
            truth_ids=truth.class_ids,
            scores=found.scores,
            is_evaluated=table.is_evaluated,
        )
        if self._criteria.distances == "nuscenes":
            matches = np.concatenate([matches, self._nuscenes_matches(pairs, found, truth, table, is_outside)])
        errors = np.full((len(self._criteria.error_rows), len(found), _ERRORS), np.nan, np.float32)
        for row, criterion_row in enumerate(self._criteria.error_rows):
            right = np.flatnonzero(matches[criterion_row] >= 0)
            errors[row, right] = errors_of_pairs(found, truth, right, matches[criterion_row, right])
        return FoundTable(
            found.frames,
            found.class_ids,
            found.scores,
            *self._places(found.centers),
            found.yaws.astype(np.float32),
            np.where(matches >= 0, matches + self._truth_count, matches).astype(np.int32),
            np.where(mistaken >= 0, mistaken + self._truth_count, FALSE).astype(np.int32),
            errors,
        )

    def _nuscenes_matches(
        self, pairs: Candidates, found: FoundObjects, truth: TrueObjects, table: TruthTable, is_outside: Bools
    ) -> I32:
        # nuScenes takes away what is too far and what no lidar hits before it matches; it ignores nothing
        is_left = ~is_outside & (_ranges(found.centers) < self._nuscenes_m[found.class_ids])
        at_ignored = truth.is_ignored | table.is_nuscenes
        left = pairs.select(np.flatnonzero(is_left[pairs.found] & at_ignored[pairs.truth]))
        return match_criteria(
            left,
            self._criteria.by_distance,
            position=self._criteria.position,
            found_ids=found.class_ids,
            truth_ids=truth.class_ids,
            scores=found.scores,
            is_evaluated=table.is_nuscenes,
            is_ignored=~is_left,
        )

    def _places(self, centers: F64) -> tuple[I16, I16]:
        bins = range_rows(centers, self._edges_m)
        return bins.astype(np.int16), first_polygon_with(self._polygons, centers[:, :2]).astype(np.int16)


def _ranges(centers: F64) -> F64:
    return np.hypot(centers[:, 0], centers[:, 1])


def _no_truth() -> TruthTable:
    whole, small = np.zeros(0, np.int32), np.zeros(0, np.int16)
    flags = np.zeros(0, np.bool_)
    return TruthTable(whole, whole, whole, small, small, whole, np.zeros(0, np.float32), flags, flags)


def _no_detections(criteria: int, error_rows: int) -> FoundTable:
    whole, small, real = np.zeros(0, np.int32), np.zeros(0, np.int16), np.zeros(0, np.float32)
    matches, errors = np.zeros((criteria, 0), np.int32), np.zeros((error_rows, 0, _ERRORS), np.float32)
    return FoundTable(whole, whole, real, small, small, real, matches, whole, errors)
