"""Frames of a result to the tables that the figures are made of."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.core.geometry.polygons import first_polygon_with
from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.criteria import Criteria
from lidcam.pipeline.evaluation.detection.errors import Column, errors_of_pairs
from lidcam.pipeline.evaluation.detection.matching import match_criteria
from lidcam.pipeline.evaluation.detection.tables import FoundTable, TruthTable
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame
from lidcam.pipeline.evaluation.ignoring import is_evaluated, is_within
from lidcam.pipeline.evaluation.near_objects import FoundObjects, TrueObjects, pairs_near
from lidcam.pipeline.evaluation.pieces import Pieces
from lidcam.pipeline.evaluation.scales import range_edges_m, range_rows, ranges_m
from lidcam.pipeline.evaluation.true_motion import ground_poses, ground_turns

_MAX_FRAMES = 128
"""Largest number of frames that are matched together."""

_MAX_PAIRS = 1 << 18
"""Largest number of pairs of boxes that are matched together, which bounds memory."""


class Gathering:
    """Matches the 3D boxes of frames with truth, some frames at a time, and keeps what the figures need.

    The parts of the site that have figures of their own are its ranges, and then its zones; an object belongs to the
    first zone that holds its centre.
    """

    def __init__(self, config: Config, zones: Sequence[Zone]) -> None:
        self.stamps_ns: list[int] = []
        self.frames_without_truth = 0
        self._settings = config.evaluate
        self._criteria = Criteria.of(config)
        self._edges_m = range_edges_m(config)
        self._polygons = [zone.polygon_site for zone in zones]
        self._parts_shape = (len(self._edges_m) + len(zones),)
        self._truth = Pieces(TruthTable, parts=self._parts_shape, poses=(3,))
        self._truth_count = 0
        self._found: dict[str, Pieces[FoundTable]] = {}
        self._waiting: list[EvaluationFrame] = []
        self._waiting_pairs = 0

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame; the numbers in it are finite, as readers make sure."""
        for source in frame.sources:
            if source not in self._found:
                self._found[source] = Pieces(
                    FoundTable,
                    parts=self._parts_shape,
                    matches=(self._criteria.distance_columns.stop,),
                    errors=(len(Column),),
                    velocities=(3,),
                )
        if frame.truth is None:
            self.frames_without_truth += 1
            return
        self._waiting.append(frame)
        self._waiting_pairs += len(frame.truth) * max((len(source) for source in frame.sources.values()), default=0)
        if len(self._waiting) >= _MAX_FRAMES or self._waiting_pairs >= _MAX_PAIRS:
            self._match()

    def truth(self) -> TruthTable:
        """The true objects."""
        self._match()
        return self._truth.table()

    def found(self) -> dict[str, FoundTable]:
        """The detections, by source."""
        self._match()
        return {source: pieces.table() for source, pieces in self._found.items()}

    def _match(self) -> None:
        frames, self._waiting, self._waiting_pairs = self._waiting, [], 0
        if not frames:
            return
        first = len(self.stamps_ns)
        self.stamps_ns.extend(frame.stamp_ns for frame in frames)
        truth = TrueObjects.of([frame.truth for frame in frames if frame.truth is not None], first)
        unknown = np.full((4, 4), np.nan)
        poses = np.array([unknown if frame.T_fixed_site is None else frame.T_fixed_site for frame in frames])
        table = self._truth_table(truth, poses[truth.frames - first])
        for source, pieces in self._found.items():
            found = FoundObjects.of([frame.sources.get(source) for frame in frames], first)
            pieces.append(self._found_table(found, truth, table, poses[found.frames - first]))
        self._truth.append(table)
        self._truth_count += len(truth)

    def _truth_table(self, truth: TrueObjects, poses: F64) -> TruthTable:
        boxes = truth.boxes
        return TruthTable(
            frames=truth.frames,
            class_ids=boxes.class_ids,
            labels=boxes.labels,
            parts=self._parts(boxes.centers),
            is_evaluated=is_evaluated(boxes, self._settings),
            track_ids=boxes.track_ids,
            poses=ground_poses(boxes.centers, boxes.yaws, poses),
        )

    def _found_table(self, found: FoundObjects, truth: TrueObjects, table: TruthTable, poses: F64) -> FoundTable:
        pairs, criteria, boxes = pairs_near(found, truth, self._criteria.scales), self._criteria, found.boxes
        matches = match_criteria(
            pairs,
            [*criteria.by_overlap, *criteria.by_distance],
            rules=criteria,
            found=boxes,
            truth=truth.boxes,
            is_evaluated=table.is_evaluated,
            is_ignored=found.is_ignored | ~is_within(boxes.centers, self._settings),
        )
        errors = np.full((len(found), len(Column)), np.nan, np.float32)
        right = np.flatnonzero(matches[:, criteria.position_column] >= 0)
        errors[right] = errors_of_pairs(boxes, truth.boxes, right, matches[right, criteria.position_column])
        velocities = ground_turns(found.motion.velocities, poses)
        return FoundTable(
            frames=found.frames,
            class_ids=boxes.class_ids,
            scores=boxes.scores,
            parts=self._parts(boxes.centers),
            matches=np.where(matches >= 0, matches + self._truth_count, matches).astype(np.int32),
            errors=errors,
            velocities=np.column_stack([velocities, found.motion.yaw_rates]).astype(np.float32),
            is_predicted=found.motion.is_predicted,
        )

    def _parts(self, centers: F64) -> Bools:
        """(N, P) parts of the site in which centres lie."""
        ranges = range_rows(ranges_m(centers), self._edges_m)
        zones = first_polygon_with(self._polygons, centers[:, :2])
        in_range = ranges[:, None] == np.arange(len(self._edges_m))
        return np.hstack([in_range, zones[:, None] == np.arange(len(self._polygons))])
