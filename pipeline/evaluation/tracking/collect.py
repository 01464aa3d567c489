"""Tables of tracks, from frames.

Frames are kept until a block of them is full. The boxes of a block that count are then chosen for all of its frames at
once, and only what the figures need is kept: a few numbers a box, and the pairs that are near each other.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Bools, Indices, first_of_runs, select_rows
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.assignment import assign_nearest
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, in_order
from lidcam.pipeline.evaluation.ignoring import is_evaluated, is_within
from lidcam.pipeline.evaluation.near_objects import Candidates, FoundObjects, TrueObjects, pairs_near
from lidcam.pipeline.evaluation.pieces import Pieces
from lidcam.pipeline.evaluation.scales import length_scales
from lidcam.pipeline.evaluation.tracking.table import TrackRows, TrackTable
from lidcam.pipeline.evaluation.vans import Vans

MAX_DISTANCE_M = 2.0
"""Distance from which on nothing is matched (nuScenes tracking task), for objects as long as a car."""

BLOCK_FRAMES = 16


class _Source:
    def __init__(self) -> None:
        self.found = Pieces(TrackRows)
        self.pairs = Pieces(Candidates)
        self.count = 0
        self.has_tracks = False


class Collection:
    """Truth and results of all frames that have truth, by source."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._scales = length_scales(config)
        self._max_distances_m = MAX_DISTANCE_M * self._scales
        self._frames: list[EvaluationFrame] = []
        self._stamps_ns: list[int] = []
        self._truth = Pieces(TrackRows)
        self._truth_count = 0
        self._vans, self._is_van = Vans(config), [np.zeros(0, np.bool_)]
        self._tracked_truth = self._untracked_truth = 0
        self._sources: dict[str, _Source] = {}

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in a frame; one without truth says nothing."""
        if frame.truth is None:
            return
        self._frames.append(frame)
        self._stamps_ns.append(frame.stamp_ns)
        if len(self._frames) == BLOCK_FRAMES:
            self._close_block()

    def tables(self) -> Iterator[tuple[str, tuple[TrackTable, ...]]]:
        """Source by source, in their order, a table for each class; only sources that have tracks.

        Nothing if there is truth and none of it has a track: nobody knows then who is who.
        """
        self._close_block()
        if self._untracked_truth and not self._tracked_truth:
            return
        truth, stamps_ns = self._truth.table(), np.array(self._stamps_ns, np.int64)
        for name in in_order(self._sources):
            source = self._sources[name]
            if source.has_tracks:
                classes = range(len(self._config.classes))
                of_source = replace(truth, class_ids=self._classes_of(truth, source))
                yield name, tuple(self._table(stamps_ns, of_source, source, class_id) for class_id in classes)

    def _close_block(self) -> None:
        frames, self._frames = self._frames, []
        if not frames:
            return
        first = len(self._stamps_ns) - len(frames)
        truth = TrueObjects.of([frame.truth for frame in frames if frame.truth is not None], first)
        boxes, no_scores = truth.boxes, np.zeros(len(truth))
        is_tracked = boxes.track_ids != UNKNOWN  # an object whose track is not known cannot be followed
        self._tracked_truth += int(is_tracked.sum())
        self._untracked_truth += int((~is_tracked).sum())
        is_counted = is_tracked & is_evaluated(boxes, self._config.evaluate)
        rows = _rows_in_order(truth.frames, boxes.class_ids, boxes.track_ids, no_scores, is_counted)
        counted, ignored = select_rows(truth, rows), select_rows(truth, np.setdiff1d(np.arange(len(truth)), rows))
        for name in dict.fromkeys(name for frame in frames for name in frame.sources):
            found = FoundObjects.of([frame.sources.get(name) for frame in frames], first)
            self._add_found(self._sources.setdefault(name, _Source()), found, counted, ignored)
        boxes, no_scores = counted.boxes, no_scores[: len(counted)]
        self._truth.append(TrackRows(counted.frames, boxes.class_ids, boxes.track_ids, boxes.yaws, no_scores))
        self._is_van.append(self._vans.among(boxes.class_ids, boxes.labels))
        self._truth_count += len(counted)

    def _add_found(self, source: _Source, found: FoundObjects, counted: TrueObjects, ignored: TrueObjects) -> None:
        source.has_tracks |= bool((found.track_ids != UNKNOWN).any())
        class_ids, scores = found.boxes.class_ids, found.boxes.scores.astype(np.float64)
        rows = _rows_in_order(found.frames, class_ids, found.track_ids, scores, found.track_ids != UNKNOWN)
        found = select_rows(found, rows)
        class_ids, scores = found.boxes.class_ids, scores[rows]
        pairs = pairs_near(found, counted, self._scales)
        true_ids = counted.boxes.class_ids
        is_van = self._vans.among(true_ids, counted.boxes.labels)
        pairs = pairs.select(self._vans.fit(true_ids[pairs.truth], is_van[pairs.truth], class_ids[pairs.found]))
        kept = ~found.is_ignored & is_within(found.boxes.centers, self._config.evaluate)
        beside = pairs_near(found, ignored, self._scales)
        kept[beside.found[beside.distances_m < self._max_distances_m[class_ids[beside.found]]]] = False
        if not kept.all():
            # A matched box counts, also if it lies outside or beside something that is ignored.
            close = pairs.select(pairs.distances_m < self._max_distances_m[class_ids[pairs.found]])
            kept[close.found[assign_nearest(close.truth, close.found, close.distances_m)]] = True
            pairs = pairs.among(np.ones(len(counted), np.bool_), kept)
            found, class_ids, scores = select_rows(found, kept), class_ids[kept], scores[kept]
        source.found.append(TrackRows(found.frames, class_ids, found.track_ids, found.boxes.yaws, scores))
        rows_so_far = pairs.truth + self._truth_count, pairs.found + source.count
        source.pairs.append(Candidates(*rows_so_far, pairs.bev, pairs.volume, pairs.distances_m))
        source.count += len(found)

    def _classes_of(self, truth: TrackRows, source: _Source) -> I32:
        """(T,) classes of true objects; a van is at all times of the class whose boxes there have the most score."""
        is_van, pairs, found = np.concatenate(self._is_van), source.pairs.table(), source.found.table()
        found_ids = found.class_ids[pairs.found]
        at_van = is_van[pairs.truth] & (pairs.distances_m < self._max_distances_m[found_ids])
        _, numbers = np.unique(truth.tracks, return_inverse=True)
        votes = np.zeros((numbers.max(initial=-1) + 1, len(self._config.classes)))
        np.add.at(votes, (numbers[pairs.truth[at_van]], found_ids[at_van]), found.scores[pairs.found[at_van]])
        is_shown = is_van & (votes.sum(1) > 0)[numbers]
        return np.where(is_shown, votes.argmax(1)[numbers], truth.class_ids).astype(np.int32)

    def _table(self, stamps_ns: I64, truth: TrackRows, source: _Source, class_id: int) -> TrackTable:
        found = source.found.table()
        is_true, is_found = truth.class_ids == class_id, found.class_ids == class_id
        return TrackTable(
            stamps_ns,
            truth.numbered(is_true),
            found.numbered(is_found),
            source.pairs.table().among(is_true, is_found),
            float(self._max_distances_m[class_id]),
        )


def _rows_in_order(frames: I32, class_ids: I32, tracks: I64, scores: F64, is_counted: Bools) -> Indices:
    """The counted rows by frame, class and track; of those that share all three, the one of the highest score."""
    rows = np.flatnonzero(is_counted)
    rows = rows[np.lexsort((-scores[rows], tracks[rows], class_ids[rows], frames[rows]))]
    return rows[first_of_runs(frames[rows]) | first_of_runs(class_ids[rows]) | first_of_runs(tracks[rows])]
