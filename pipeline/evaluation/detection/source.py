"""The figures of one source of 3D boxes."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, Bools
from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.settings.config import ALL_CLASSES, Config
from lidcam.pipeline.evaluation.detection.averages import (
    Averages,
    ap_by_distance_name,
    distance_figures,
    mean_figures,
    overlap_figures,
)
from lidcam.pipeline.evaluation.detection.counts import calibration_figures, count_figures
from lidcam.pipeline.evaluation.detection.criteria import DISTANCES_M, Criteria
from lidcam.pipeline.evaluation.detection.curves import curve_of, ratio
from lidcam.pipeline.evaluation.detection.errors import (
    Column,
    bird_eye_m,
    error_figures,
    motion_figures,
    nees_figures,
    spread,
)
from lidcam.pipeline.evaluation.detection.gathering import Gathering
from lidcam.pipeline.evaluation.detection.matching import by_falling_score
from lidcam.pipeline.evaluation.detection.tables import FALSE, IGNORED, FoundTable, Scored, TruthTable
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, Figures
from lidcam.pipeline.evaluation.scales import range_edges_m, range_names
from lidcam.pipeline.evaluation.true_motion import has_moved, true_velocities
from lidcam.pipeline.evaluation.vans import as_found


class Part(NamedTuple):
    """A part of the site that has figures of its own; `extent` is the reach of a range."""

    kind: Literal["ranges", "zones"]
    name: str
    extent: dict[str, float | None]


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """The truth and the settings that the figures of all sources share."""

    class_names: tuple[str, ...]  # By class id
    criteria: Criteria  # When a detection counts as right
    truth: TruthTable  # All true objects
    parts: tuple[Part, ...]  # The parts of the site, in the order of the columns of the tables
    frames: int  # Frames that are evaluated
    frames_without_truth: int  # Frames that are not
    velocities: F64  # (T, 3) float64, of the true objects over the ground: see `true_velocities`
    moves: Bools  # (T,) bool, which of them move in the recording

    @classmethod
    def of(cls, config: Config, zones: Sequence[Zone], gathering: Gathering) -> "Site":
        """The site of a result, with all truth that was gathered."""
        edges_m = range_edges_m(config)
        starts_m, ends_m = edges_m.tolist(), [*edges_m[1:].tolist(), None]
        ranges = (
            Part("ranges", name, {"from_m": start_m, "to_m": end_m})
            for name, start_m, end_m in zip(range_names(edges_m), starts_m, ends_m, strict=True)
        )
        truth = gathering.truth()
        stamps_ns = np.array(gathering.stamps_ns, np.int64)
        velocities = true_velocities(truth.frames, stamps_ns, truth.class_ids, truth.track_ids, truth.poses)
        if config.evaluate.truth_time != "stamp":  # places at other times than the stamps make no velocity
            velocities = np.full_like(velocities, np.nan)
        lengths_m = np.array([one.size_m[0] for one in config.classes])
        return cls(
            class_names=config.class_names,
            criteria=Criteria.of(config),
            truth=truth,
            parts=(*ranges, *(Part("zones", zone.name, {}) for zone in zones)),
            frames=len(gathering.stamps_ns),
            frames_without_truth=gathering.frames_without_truth,
            velocities=velocities,
            moves=has_moved(truth.class_ids, truth.track_ids, truth.poses, lengths_m),
        )

    def count(self, is_counted: Bools, part: int | None) -> int:
        """Number of counted rows of the truth in a part of the site (None: in all of it)."""
        return int((is_counted if part is None else is_counted & self.truth.parts[:, part]).sum())


class Source:
    """The detections of one source, and their figures. A class of None stands for all classes, a part for all parts."""

    def __init__(self, site: Site, found: FoundTable) -> None:
        self.site = site
        self.found = found
        matches = found.matches[:, site.criteria.position_column]
        self.class_ids = as_found(site.truth.class_ids, matches, found.class_ids)
        self._scored: dict[int, Scored] = {}
        self._scored_class: int | None = UNKNOWN

    def scored(self, class_id: int | None, criterion: int) -> Scored:
        """The detections of a class that count under a criterion (a column of the matches), by falling score."""
        found = self.found
        if class_id != self._scored_class:  # kept of one class at a time: those of all classes take much memory
            rows = np.flatnonzero(_is_of(found.class_ids, class_id))
            self._scored, self._scored_class = {}, class_id
            self._order = rows[by_falling_score(found.scores[rows])]
        if criterion not in self._scored:
            rows = self._order[found.matches[self._order, criterion] != IGNORED]
            matches = found.matches[rows, criterion]
            is_right, parts = matches != FALSE, found.parts[rows]
            parts[is_right] = self.site.truth.parts[matches[is_right]]
            self._scored[criterion] = Scored(rows, matches, found.scores[rows], is_right, parts)
        return self._scored[criterion]

    def is_evaluated(self, class_id: int | None) -> Bools:
        """(T,) which true objects of a class are evaluated."""
        return self.site.truth.is_evaluated & _is_of(self.class_ids, class_id)

    def figures(self) -> Mapping[str, Figures]:
        """All figures, by class."""
        site = self.site
        figures: dict[str, dict[str, Figures | float | int | None]] = {}
        averages: dict[int | None, list[tuple[Averages, Averages]]] = defaultdict(list)
        for class_id, class_name in [*enumerate(site.class_names), (None, ALL_CLASSES)]:
            parts: dict[str, dict[str, Figures]] = {"ranges": {}, "zones": {}}
            for column, part in enumerate(site.parts):
                parts[part.kind][part.name] = {**part.extent, **self._at(class_id, column, averages[column])}
            detections = self.scored(class_id, site.criteria.position_column)
            figures[class_name] = {
                **self._at(class_id, None, averages[None]),
                "frames": site.frames,
                "frames_without_truth": site.frames_without_truth,
                "labels": self._label_recalls(class_id, detections),
                "calibration": calibration_figures(detections.scores, detections.is_right),
                **parts,
            }
        return figures

    def _at(
        self, class_id: int | None, part: int | None, averages: list[tuple[Averages, Averages]]
    ) -> dict[str, Figures | float | int | None]:
        """The figures of a class in a part of the site; those of all classes have the means of the classes before.

        `averages` are the average precisions of these classes, by overlap and by distance.
        """
        pooled = self._pooled(class_id, part)
        if class_id is None:
            overlaps, distances = map(mean_figures, zip(*averages, strict=True))
            return {**pooled, **overlaps, "distance": distances}
        criteria = self.site.criteria
        count = self.site.count(self.is_evaluated(class_id), part)

        def by_criterion(column: int) -> Scored:
            return self.scored(class_id, column).within(part)

        overlaps = overlap_figures(criteria, by_criterion, count)
        distances = distance_figures(criteria, by_criterion, count)
        averages.append((overlaps, distances))
        limits = {"thresholds": self._distances_m(class_id)} if part is None else {}
        return {**pooled, **overlaps, "distance": {**distances, **limits}}

    def _pooled(self, class_id: int | None, part: int | None) -> dict[str, Figures | float | int | None]:
        site, found = self.site, self.found
        position = site.criteria.position_column
        left_out = ~site.truth.is_evaluated & _is_of(self.class_ids, class_id)
        detections = self.scored(class_id, position).within(part)
        is_ignored = (found.matches[:, position] == IGNORED) & _is_of(found.class_ids, class_id)
        ignored = int((is_ignored if part is None else is_ignored & found.parts[:, part]).sum())
        curve = curve_of(detections.scores, detections.is_right, site.count(self.is_evaluated(class_id), part))
        return {
            **count_figures(curve, ignored, site.count(left_out, part)),
            "false_per_frame": ratio(int((~detections.is_right).sum()), site.frames),
            "errors": self._errors(detections.select(detections.is_right)),
            "predicted": self._predicted(detections),
        }

    def _errors(self, right: Scored) -> Figures:
        site, errors, truth_rows = self.site, self.found.errors[right.rows], right.truth_rows
        motion_errors = self.found.velocities[right.rows] - site.velocities[truth_rows]
        motion = motion_figures(errors, motion_errors, site.moves[truth_rows])
        return {**error_figures(errors), **motion}

    def _predicted(self, detections: Scored) -> Figures:
        """Figures of detections that were predicted: nothing of the object was seen in the frame."""
        predicted = detections.select(self.found.is_predicted[detections.rows])
        errors = self.found.errors[predicted.rows[predicted.is_right]]
        return {
            "found": len(predicted),
            "right": len(errors),
            "precision": ratio(len(errors), len(predicted)),
            "position_bev_m": spread(bird_eye_m(errors)),
            "nees": nees_figures(errors[:, Column.NEES]),
        }

    def _label_recalls(self, class_id: int | None, detections: Scored) -> Figures:
        truth = self.site.truth
        is_counted = self.is_evaluated(class_id)
        is_right = np.zeros(len(truth), np.bool_)
        is_right[detections.truth_rows[detections.is_right]] = True
        figures: dict[str, Figures] = {}
        for name in np.unique(truth.labels[is_counted]).tolist():
            is_own = is_counted & (truth.labels == name)
            count, right = int(is_own.sum()), int((is_own & is_right).sum())
            figures[name] = {"truth": count, "right": right, "recall": ratio(right, count)}
        return figures

    def _distances_m(self, class_id: int) -> list[Figures]:
        scale = self.site.criteria.scales[class_id]
        return [{"figure": ap_by_distance_name(one), "distance_m": float(one * scale)} for one in DISTANCES_M]


def _is_of(class_ids: I32, class_id: int | None) -> Bools:
    return np.ones(len(class_ids), np.bool_) if class_id is None else class_ids == class_id
