"""From frames to tables of tracks.

Frames are kept until a block of them is full. What of a block counts is then decided for all of its frames at once, and
only what the figures need is kept: a few numbers a box, and the pairs that are near each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, Indices
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.rotated_iou import BoxArrays, pair_ious
from pipeline.core.settings.config import Config
from pipeline.evaluation.assignment import assign_nearest, pairs_of_equal
from pipeline.evaluation.ignoring import is_evaluated, is_within
from pipeline.evaluation.records import UNKNOWN, EvaluationFrame, SourceBoxes, TruthBoxes3D
from pipeline.evaluation.scales import length_scales
from pipeline.evaluation.tracking.table import TrackTable

__all__ = ["MAX_DISTANCE_M", "Collection"]

MAX_DISTANCE_M = 2.0
"""From this distance on nothing is matched (nuScenes tracking task), for objects as long as a car."""

BLOCK_FRAMES = 256

_NO_ROWS, _NO_VALUES = np.zeros(0, np.int64), np.zeros(0)

Part = TypeVar("Part", "_Truth", "_Found", "_Pairs")


@dataclass(frozen=True, slots=True, eq=False)
class _Truth:
    """True objects that have to be found; `frames` are positions among the frames with truth."""

    frames: I64
    class_ids: I64
    tracks: I64
    yaws: F64
    ranges_m: F64


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Boxes of one source that count."""

    frames: I64
    class_ids: I64
    tracks: I64
    yaws: F64
    ranges_m: F64
    scores: F64


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Pairs of rows of all truth and all boxes found."""

    first: I64
    second: I64
    distances_m: F64
    ious: F64


class _Source:
    """What was found by one source so far."""

    def __init__(self, class_count: int) -> None:
        self.found = [_Found(_NO_ROWS, _NO_ROWS, _NO_ROWS, _NO_VALUES, _NO_VALUES, _NO_VALUES)]
        self.pairs = [_Pairs(_NO_ROWS, _NO_ROWS, _NO_VALUES, _NO_VALUES)]
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
        self._truth = [_Truth(_NO_ROWS, _NO_ROWS, _NO_ROWS, _NO_VALUES, _NO_VALUES)]
        self._truth_count = 0
        self._sources: dict[str, _Source] = {}

    def add(self, frame: EvaluationFrame) -> None:
        """Take in a frame; one without truth says nothing."""
        if frame.truth is None:
            return
        self._frames.append((frame.truth, dict(frame.sources)))
        self._stamps_ns.append(frame.stamp_ns)
        if len(self._frames) == BLOCK_FRAMES:
            self._close_block()

    def tables(self) -> dict[str, tuple[TrackTable, ...]]:
        """By source, in the order of their names, a table for each class; only sources that have tracks."""
        self._close_block()
        truth = _joined(self._truth)
        return {
            name: tuple(self._table(truth, source, class_id) for class_id in range(len(self._config.classes)))
            for name, source in sorted(self._sources.items())
            if source.has_tracks
        }

    def _close_block(self) -> None:
        frames, self._frames = self._frames, []
        if not frames:
            return
        first_frame = len(self._stamps_ns) - len(frames)
        truths = [truth for truth, _ in frames]
        counts = np.array([len(truth) for truth in truths])
        truth_frames = np.repeat(np.arange(first_frame, first_frame + len(frames)), counts)
        class_ids = np.concatenate([truth.class_ids for truth in truths]).astype(np.int64)
        tracks = np.concatenate([truth.track_ids for truth in truths])
        boxes = _boxes(truths)
        counting = np.concatenate([is_evaluated(truth, self._config.evaluate) for truth in truths])
        # An object whose track is not known cannot be followed.
        counting &= tracks != UNKNOWN
        rows = np.flatnonzero(counting)
        rows = rows[np.lexsort((tracks[rows], class_ids[rows], truth_frames[rows]))]
        repeated = _is_repeated(truth_frames[rows], class_ids[rows], tracks[rows])
        counting[rows[repeated]] = False
        rows = rows[~repeated]
        ranges_m = np.hypot(*boxes.centers[rows, :2].T)
        truth = _Truth(truth_frames[rows], class_ids[rows], tracks[rows], boxes.yaws[rows], ranges_m)
        ignored = np.flatnonzero(~counting)
        for name in {name for _, sources in frames for name in sources}:
            self._sources.setdefault(name, _Source(len(self._config.classes)))
        for name in self._sources:
            given = [(first_frame + k, sources[name]) for k, (_, sources) in enumerate(frames) if name in sources]
            if given:
                self._add_found(name, given, truth, _rows(boxes, rows), truth_frames[ignored], _rows(boxes, ignored))
        self._truth.append(truth)
        self._truth_count += len(rows)

    def _add_found(
        self,
        name: str,
        given: Sequence[tuple[int, SourceBoxes]],
        truth: _Truth,
        truth_boxes: BoxArrays,
        ignored_frames: I64,
        ignored_boxes: BoxArrays,
    ) -> None:
        source = self._sources[name]
        parts = [part.boxes for _, part in given]
        boxes = _boxes(parts)
        tracks = np.concatenate([part.track_ids for _, part in given])
        class_ids = np.concatenate([part.class_ids for part in parts]).astype(np.int64)
        scores = np.concatenate([part.scores for part in parts]).astype(np.float64)
        frames = np.repeat([frame for frame, _ in given], [len(part) for part in parts]).astype(np.int64)
        source.has_tracks |= bool((tracks != UNKNOWN).any())
        order = np.lexsort((-scores, tracks, class_ids, frames))
        keys = frames[order], class_ids[order], tracks[order]
        lost = (keys[2] == UNKNOWN) | _is_repeated(*keys)
        source.without_track += np.bincount(keys[1][lost], minlength=len(source.without_track))
        rows = order[~lost]
        pairs = self._near_pairs(
            truth.frames, truth.class_ids, truth_boxes, frames[rows], class_ids[rows], _rows(boxes, rows)
        )
        optional = ~is_within(boxes.centers[rows], self._config.evaluate)
        near = self._near_rows(ignored_frames, ignored_boxes, frames[rows], class_ids[rows], _rows(boxes, rows))
        optional[near] = True
        if optional.any():
            kept = ~optional
            close = np.flatnonzero(pairs.distances_m < self._max_distances_m[truth.class_ids[pairs.first]])
            matched = assign_nearest(pairs.first[close], pairs.second[close], pairs.distances_m[close])
            kept[pairs.second[close[matched]]] = True
            renumbered = np.cumsum(kept) - 1
            held = kept[pairs.second]
            pairs = _Pairs(pairs.first[held], renumbered[pairs.second[held]], pairs.distances_m[held], pairs.ious[held])
            rows = rows[kept]
        ranges_m = np.hypot(*boxes.centers[rows, :2].T)
        source.found.append(
            _Found(frames[rows], class_ids[rows], tracks[rows], boxes.yaws[rows], ranges_m, scores[rows])
        )
        shifted = pairs.first + self._truth_count, pairs.second + source.count
        source.pairs.append(_Pairs(*shifted, pairs.distances_m, pairs.ious))
        source.count += len(rows)

    def _near_pairs(
        self, frames: I64, class_ids: I64, boxes: BoxArrays, found_frames: I64, found_class_ids: I64, found: BoxArrays
    ) -> _Pairs:
        """Pairs of one frame and class that may be one object."""
        classes = len(self._config.classes)
        first, second = pairs_of_equal(frames * classes + class_ids, found_frames * classes + found_class_ids)
        distances_m = np.hypot(*(boxes.centers[first, :2] - found.centers[second, :2]).T)
        reach_m = np.hypot(*boxes.sizes[first, :2].T) / 2 + np.hypot(*found.sizes[second, :2].T) / 2
        near = (distances_m < self._max_distances_m[class_ids[first]]) | (distances_m < reach_m)
        first, second, distances_m = first[near], second[near], distances_m[near]
        return _Pairs(first, second, distances_m, pair_ious(_rows(boxes, first), _rows(found, second)).bev)

    def _near_rows(
        self, frames: I64, boxes: BoxArrays, found_frames: I64, found_class_ids: I64, found: BoxArrays
    ) -> Indices:
        """The boxes found, of whatever class, that are near one of the given objects of their frame."""
        order = np.argsort(frames, kind="stable")
        first, second = pairs_of_equal(frames[order], found_frames)
        distances_m = np.hypot(*(boxes.centers[order[first], :2] - found.centers[second, :2]).T)
        return np.asarray(second[distances_m < self._max_distances_m[found_class_ids[second]]])

    def _table(self, truth: _Truth, source: _Source, class_id: int) -> TrackTable:
        found, pairs = _joined(source.found), _joined(source.pairs)
        truth_rows, found_rows = truth.class_ids == class_id, found.class_ids == class_id
        held = truth_rows[pairs.first]
        truth_numbers, found_numbers = np.cumsum(truth_rows) - 1, np.cumsum(found_rows) - 1
        return TrackTable(
            np.array(self._stamps_ns, np.int64),
            truth.frames[truth_rows],
            np.unique(truth.tracks[truth_rows], return_inverse=True)[1].astype(np.int64),
            truth.yaws[truth_rows],
            truth.ranges_m[truth_rows],
            found.frames[found_rows],
            np.unique(found.tracks[found_rows], return_inverse=True)[1].astype(np.int64),
            found.yaws[found_rows],
            found.ranges_m[found_rows],
            found.scores[found_rows],
            truth_numbers[pairs.first[held]],
            found_numbers[pairs.second[held]],
            pairs.distances_m[held],
            pairs.ious[held],
            float(self._max_distances_m[class_id]),
            int(source.without_track[class_id]),
        )


def _boxes(parts: Sequence[TruthBoxes3D] | Sequence[Boxes3D]) -> BoxArrays:
    return BoxArrays(
        np.concatenate([part.centers for part in parts]),
        np.concatenate([part.sizes for part in parts]),
        np.concatenate([part.yaws for part in parts]),
    )


def _rows(boxes: BoxArrays, rows: Indices | I64) -> BoxArrays:
    return BoxArrays(boxes.centers[rows], boxes.sizes[rows], boxes.yaws[rows])


def _is_repeated(frames: I64, class_ids: I64, tracks: I64) -> Bools:
    """Whether a row, of rows in this order, has the frame, class and track of the row before it."""
    same = np.zeros(len(frames), np.bool_)
    same[1:] = (np.diff(frames) == 0) & (np.diff(class_ids) == 0) & (np.diff(tracks) == 0)
    return same


def _joined(parts: Sequence[Part]) -> Part:
    kind = type(parts[0])
    return kind(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(kind)))
