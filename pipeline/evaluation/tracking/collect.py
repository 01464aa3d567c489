"""From frames to tables of tracks.

Frames are kept until a block of them is full. What of a block counts is then decided for all of its frames at once, and
only what the figures need is kept: a few numbers a box, and the pairs that are near each other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.settings.config import Config
from pipeline.evaluation.assignment import assign_nearest
from pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, SourceBoxes, TruthBoxes3D, in_order
from pipeline.evaluation.ignoring import is_evaluated, is_within
from pipeline.evaluation.pieces import Pieces
from pipeline.evaluation.scales import length_scales
from pipeline.evaluation.tracking.candidates import Candidates, Objects, near_pairs, near_rows
from pipeline.evaluation.tracking.table import TrackTable

__all__ = ["MAX_DISTANCE_M", "Collection"]

MAX_DISTANCE_M = 2.0
"""From this distance on nothing is matched (nuScenes tracking task), for objects as long as a car."""

BLOCK_FRAMES = 256

_NO_ROWS, _NO_VALUES = np.zeros(0, np.int64), np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    """True objects, or boxes found, that count; `frames` are positions among the frames with truth."""

    frames: I64
    class_ids: I64
    tracks: I64
    yaws: F64
    ranges_m: F64
    scores: F64

    @classmethod
    def of(cls, objects: Objects, scores: F64) -> "_Kept":
        yaws, ranges_m = objects.boxes.yaws, objects.ranges_m
        return cls(objects.frames, objects.class_ids, objects.tracks, yaws, ranges_m, scores)


_NONE_KEPT = _Kept(_NO_ROWS, _NO_ROWS, _NO_ROWS, _NO_VALUES, _NO_VALUES, _NO_VALUES)


@dataclass(frozen=True, slots=True, eq=False)
class _BlockTruth:
    """The truth of a block: what has to be found, and what is ignored."""

    counting: Objects
    ignored: Objects


class _Source:
    """What was found by one source so far."""

    def __init__(self, class_count: int) -> None:
        self.found = Pieces(_NONE_KEPT)
        self.pairs = Pieces(Candidates(_NO_ROWS, _NO_ROWS, _NO_VALUES, _NO_VALUES))
        self.count = 0
        self.without_track = np.zeros(class_count, np.int64)
        self.has_tracks = False


class Collection:
    """Truth and results of all frames that have truth, by source."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._max_distances_m = MAX_DISTANCE_M * length_scales(config)
        self._frames: list[tuple[TruthBoxes3D, dict[str, SourceBoxes]]] = []
        self._stamps_ns: list[int] = []
        self._truth = Pieces(_NONE_KEPT)
        self._truth_count = 0
        self._tracked_truth = self._untracked_truth = 0
        self._sources: dict[str, _Source] = {}

    def add(self, frame: EvaluationFrame) -> None:
        """Take in a frame; one without truth says nothing."""
        if frame.truth is None:
            return
        self._frames.append((frame.truth, dict(frame.sources)))
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
                yield name, tuple(self._table(stamps_ns, truth, source, class_id) for class_id in classes)

    def _close_block(self) -> None:
        frames, self._frames = self._frames, []
        if not frames:
            return
        numbers = range(len(self._stamps_ns) - len(frames), len(self._stamps_ns))
        truth = self._block_truth([truth for truth, _ in frames], numbers)
        for name in dict.fromkeys(name for _, sources in frames for name in sources):
            source = self._sources.setdefault(name, _Source(len(self._config.classes)))
            given = {n: sources[name] for n, (_, sources) in zip(numbers, frames, strict=True) if name in sources}
            self._add_found(source, given, truth)
        self._truth.append(_Kept.of(truth.counting, np.zeros(len(truth.counting))))
        self._truth_count += len(truth.counting)

    def _block_truth(self, parts: Sequence[TruthBoxes3D], numbers: Sequence[int]) -> _BlockTruth:
        objects = Objects.of(parts, numbers, np.concatenate([part.track_ids for part in parts]))
        # An object whose track is not known cannot be followed.
        is_tracked = objects.tracks != UNKNOWN
        self._tracked_truth += int(is_tracked.sum())
        self._untracked_truth += int((~is_tracked).sum())
        counting = is_tracked & np.concatenate([is_evaluated(part, self._config.evaluate) for part in parts])
        rows = np.flatnonzero(counting)
        rows = rows[np.lexsort((objects.tracks[rows], objects.class_ids[rows], objects.frames[rows]))]
        repeated = objects.select(rows).is_repeated
        counting[rows[repeated]] = False
        return _BlockTruth(objects.select(rows[~repeated]), objects.select(~counting))

    def _add_found(self, source: _Source, given: dict[int, SourceBoxes], truth: _BlockTruth) -> None:
        parts = list(given.values())
        tracks = np.concatenate([part.track_ids for part in parts])
        objects = Objects.of([part.boxes for part in parts], list(given), tracks)
        scores = np.concatenate([part.boxes.scores for part in parts]).astype(np.float64)
        order = np.lexsort((-scores, tracks, objects.class_ids, objects.frames))
        objects, scores = objects.select(order), scores[order]
        source.has_tracks |= bool((tracks != UNKNOWN).any())
        lost = (objects.tracks == UNKNOWN) | objects.is_repeated
        source.without_track += np.bincount(objects.class_ids[lost], minlength=len(source.without_track))
        objects, scores = objects.select(~lost), scores[~lost]
        pairs = near_pairs(truth.counting, objects, self._max_distances_m)
        kept = is_within(objects.boxes.centers, self._config.evaluate)
        kept &= ~near_rows(truth.ignored, objects, self._max_distances_m)
        if not kept.all():
            # What is matched counts, also if it lies outside or beside something that is ignored.
            limits_m = self._max_distances_m[truth.counting.class_ids[pairs.first]]
            close = np.flatnonzero(pairs.distances_m < limits_m)
            matched = assign_nearest(pairs.first[close], pairs.second[close], pairs.distances_m[close])
            kept[pairs.second[close[matched]]] = True
            objects, scores, pairs = objects.select(kept), scores[kept], pairs.of_found(kept)
        source.found.append(_Kept.of(objects, scores))
        first, second = pairs.first + self._truth_count, pairs.second + source.count
        source.pairs.append(Candidates(first, second, pairs.distances_m, pairs.ious))
        source.count += len(objects)

    def _table(self, stamps_ns: I64, truth: _Kept, source: _Source, class_id: int) -> TrackTable:
        found, pairs = source.found.table(), source.pairs.table()
        true_rows, found_rows = truth.class_ids == class_id, found.class_ids == class_id
        rows = true_rows[pairs.first]
        return TrackTable(
            stamps_ns=stamps_ns,
            truth_frames=truth.frames[true_rows],
            truth_tracks=np.unique(truth.tracks[true_rows], return_inverse=True)[1].astype(np.int64),
            truth_yaws=truth.yaws[true_rows],
            truth_ranges_m=truth.ranges_m[true_rows],
            found_frames=found.frames[found_rows],
            found_tracks=np.unique(found.tracks[found_rows], return_inverse=True)[1].astype(np.int64),
            found_yaws=found.yaws[found_rows],
            found_ranges_m=found.ranges_m[found_rows],
            found_scores=found.scores[found_rows],
            first=(np.cumsum(true_rows) - 1)[pairs.first[rows]],
            second=(np.cumsum(found_rows) - 1)[pairs.second[rows]],
            distances_m=pairs.distances_m[rows],
            ious=pairs.ious[rows],
            max_distance_m=float(self._max_distances_m[class_id]),
            without_track=int(source.without_track[class_id]),
        )
