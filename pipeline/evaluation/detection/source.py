"""The figures of one source of 3D boxes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F64, I32, Bools, Indices
from pipeline.core.settings.config import ALL_CLASSES
from pipeline.evaluation.detection.averages import (
    Averages,
    ap_by_distance_name,
    distance_figures,
    mean_figures,
    mean_nuscenes_figures,
    nuscenes_figures,
    overlap_figures,
)
from pipeline.evaluation.detection.counts import calibration_figures, count_figures
from pipeline.evaluation.detection.criteria import DISTANCES_M, Criteria
from pipeline.evaluation.detection.curves import Curve, curve_of, ratio
from pipeline.evaluation.detection.errors import error_figures
from pipeline.evaluation.detection.matching import by_falling_score
from pipeline.evaluation.detection.tables import (
    FALSE,
    IGNORED,
    FoundTable,
    Place,
    Scored,
    TruthTable,
    found_in,
    scored,
    truth_in,
)
from pipeline.evaluation.evaluation_frame import UNKNOWN, Figures
from pipeline.evaluation.scales import range_names

__all__ = ["Site", "Source"]

_POINTS = {"0": (0, 0), "1_5": (1, 5), "6_20": (6, 20), "21_50": (21, 50), "51_200": (51, 200), "over_200": (201, None)}


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """What the figures of all sources share.

    Attributes:
        class_names: By class id.
        criteria: When a detection counts as right.
        truth: All true objects.
        labels: The truth's own names of classes, by number.
        ranges_m: (B,) edges of the ranges, rising; the last range has no end.
        zones: Names of the zones.
        frames: Frames that are evaluated.
        frames_without_truth: Frames that are not.
    """

    class_names: tuple[str, ...]
    criteria: Criteria
    truth: TruthTable
    labels: tuple[str, ...]
    ranges_m: F64
    zones: tuple[str, ...]
    frames: int
    frames_without_truth: int

    def places(self) -> dict[Place, tuple[str, dict[str, float | None]]]:
        """The parts of the site, with the name of each and how far it reaches."""
        names, ends = range_names(self.ranges_m), [*self.ranges_m[1:].tolist(), None]
        places: dict[Place, tuple[str, dict[str, float | None]]] = {
            Place("ranges", row): (name, {"from_m": start, "to_m": end})
            for row, (name, start, end) in enumerate(zip(names, self.ranges_m.tolist(), ends, strict=True))
        }
        return places | {Place("zones", row): (name, {}) for row, name in enumerate(self.zones)}


class _ClassAverages(NamedTuple):
    """Average precisions by name of the class: by overlap, and by distance."""

    overlaps: dict[str, Averages]
    distances: dict[str, Averages]


class Source:
    """The detections of one source, and their figures.

    Args:
        site: What all sources share.
        found: The detections.
    """

    def __init__(self, site: Site, found: FoundTable) -> None:
        self.site = site
        self.found = found
        self._orders: dict[int | None, Indices] = {}
        self._scored: dict[int, Scored] = {}
        self._scored_class: int | None = None

    def scored(self, class_id: int | None, criterion_row: int) -> Scored:
        """The detections of a class (None: of all) that count under a criterion, by falling score."""
        if class_id != self._scored_class:  # kept of one class at a time: those of all classes take much memory
            self._scored, self._scored_class = {}, class_id
        if criterion_row not in self._scored:
            self._scored[criterion_row] = scored(self.found, self.site.truth, self._order(class_id), criterion_row)
        return self._scored[criterion_row]

    def is_evaluated(self, class_id: int | None) -> Bools:
        """(T,) which true objects of a class (None: of all) are evaluated."""
        return self.site.truth.is_evaluated & _is_of(self.site.truth.class_ids, class_id)

    def is_counted_by_distance(self, class_id: int) -> Bools:
        """(T,) which true objects of a class the figures by distance count."""
        if self.site.criteria.distances == "nuscenes":
            return self.site.truth.is_nuscenes & _is_of(self.site.truth.class_ids, class_id)
        return self.is_evaluated(class_id)

    def curve(self, class_id: int | None) -> Curve:
        """The curve by position of a class (None: of all)."""
        detections = self.scored(class_id, self.site.criteria.position_row)
        return curve_of(detections.scores, detections.is_right, int(self.is_evaluated(class_id).sum()))

    def figures(self) -> Mapping[str, Figures]:
        """All figures, by class."""
        figures: dict[str, dict[str, Figures | float | int | None]] = {}
        places = self.site.places()
        averages = {place: _ClassAverages({}, {}) for place in (None, *places)}
        for class_id, class_name in [*enumerate(self.site.class_names), (None, ALL_CLASSES)]:
            parts: dict[str, dict[str, Figures]] = {"ranges": {}, "zones": {}}
            for place, (name, extent) in places.items():
                parts[place.kind][name] = {**extent, **self._at(class_id, place, averages[place])}
            detections = self.scored(class_id, self.site.criteria.position_row)
            figures[class_name] = {
                **self._at(class_id, None, averages[None]),
                "frames": self.site.frames,
                "frames_without_truth": self.site.frames_without_truth,
                **self._recalls(class_id, detections),
                "calibration": calibration_figures(detections.scores, detections.is_right),
                **parts,
            }
        figures[ALL_CLASSES]["confusion"] = self._confusion()
        return figures

    def _order(self, class_id: int | None) -> Indices:
        if class_id not in self._orders:
            rows = np.flatnonzero(_is_of(self.found.class_ids, class_id))
            self._orders[class_id] = rows[by_falling_score(self.found.scores[rows])]
        return self._orders[class_id]

    def _at(
        self, class_id: int | None, place: Place | None, averages: "_ClassAverages"
    ) -> dict[str, Figures | float | int | None]:
        """The figures in a part of the site of a class, or of all (None), which has the means of the classes before."""
        by_distance = self.site.criteria.distances_name
        if class_id is None:
            overlaps, distances = (list(one.values()) for one in averages)
            is_nuscenes = by_distance == "nuscenes"
            means = mean_nuscenes_figures(averages.distances) if is_nuscenes else mean_figures(distances)
            return {**self._pooled(None, place), **mean_figures(overlaps), by_distance: means}
        name = self.site.class_names[class_id]
        averages.overlaps[name] = self._overlaps(class_id, place)
        averages.distances[name] = self._distances(class_id, place)
        limits = {"thresholds": self._distances_m(class_id)} if place is None else {}
        return {
            **self._pooled(class_id, place),
            **averages.overlaps[name],
            by_distance: {**averages.distances[name], **limits},
        }

    def _overlaps(self, class_id: int, place: Place | None) -> Averages:
        count = len(truth_in(self.site.truth, self.is_evaluated(class_id), place))
        return overlap_figures(
            self.site.criteria,
            lambda row: self.scored(class_id, row).within(place),
            self.found,
            self.site.truth,
            count,
        )

    def _distances(self, class_id: int, place: Place | None) -> Averages:
        site = self.site
        count = len(truth_in(site.truth, self.is_counted_by_distance(class_id), place))
        detections = {row: self.scored(class_id, row).within(place) for row in site.criteria.distance_rows}
        if site.criteria.distances == "nuscenes":
            return nuscenes_figures(site.criteria, detections, self.found, count, site.class_names[class_id])
        return distance_figures(site.criteria, detections, self.found, count, float(site.criteria.scales[class_id]))

    def _pooled(self, class_id: int | None, place: Place | None) -> dict[str, Figures | float | int | None]:
        site = self.site
        evaluated = truth_in(site.truth, self.is_evaluated(class_id), place)
        left_out = truth_in(site.truth, ~site.truth.is_evaluated & _is_of(site.truth.class_ids, class_id), place)
        detections = self.scored(class_id, site.criteria.position_row).within(place)
        matches = self.found.matches[site.criteria.position_row, found_in(self.found, self._order(class_id), place)]
        curve = curve_of(detections.scores, detections.is_right, len(evaluated))
        ignored, false = int((matches == IGNORED).sum()), int((~detections.is_right).sum())
        return {
            **count_figures(curve, ignored, len(left_out)),
            "false_per_frame": ratio(false, site.frames),
            "errors": error_figures(self.found.errors[0, detections.rows[detections.is_right]]),
        }

    def _recalls(self, class_id: int | None, detections: Scored) -> dict[str, Figures]:
        truth = self.site.truth
        is_counted = self.is_evaluated(class_id)
        is_right = np.zeros(len(truth), np.bool_)
        is_right[detections.truth_rows[detections.is_right]] = True
        points = truth.lidar_points
        within = {
            name: (points >= low) & (points <= (high if high is not None else points))
            for name, (low, high) in _POINTS.items()
        }
        labels = {
            name: truth.labels == row
            for row, name in sorted(enumerate(self.site.labels), key=lambda item: item[1])
            if (is_counted & (truth.labels == row)).any()
        }
        within["unknown"] = points == UNKNOWN
        return {
            "points": {name: _recall(is_counted & mask, is_right) for name, mask in within.items()},
            "labels": {name: _recall(is_counted & mask, is_right) for name, mask in labels.items()},
        }

    def _distances_m(self, class_id: int) -> list[Figures]:
        scale = self.site.criteria.scales[class_id]
        return [
            {"figure": ap_by_distance_name(limit_m), "distance_m": float(limit_m * scale)} for limit_m in DISTANCES_M
        ]

    def _confusion(self) -> Figures:
        """What the detections of each class show, by the truth's own labels."""
        site, found = self.site, self.found
        matches = found.matches[site.criteria.position_row]
        shown = np.where(matches == FALSE, found.mistaken, matches)
        classes, labels = len(site.class_names), len(site.labels)
        cells = site.truth.labels[shown[shown >= 0]] * classes + found.class_ids[shown >= 0]
        table = np.bincount(cells, minlength=classes * labels).reshape(labels, classes)
        evaluated = np.bincount(site.truth.labels[site.truth.is_evaluated], minlength=labels)
        nothing = np.bincount(found.class_ids[shown == FALSE], minlength=classes)
        rows = [row for row in sorted(range(labels), key=site.labels.__getitem__) if evaluated[row]]
        return {
            "labels": {
                site.labels[row]: {
                    "found_as": dict(zip(site.class_names, map(int, table[row]), strict=True)),
                    "missed": int(evaluated[row] - table[row].sum()),
                }
                for row in rows
            },
            "nothing": dict(zip(site.class_names, map(int, nothing), strict=True)),
        }


def _is_of(class_ids: I32, class_id: int | None) -> Bools:
    return np.ones(len(class_ids), np.bool_) if class_id is None else class_ids == class_id


def _recall(is_counted: Bools, is_right: Bools) -> Mapping[str, float | int | None]:
    truth, right = int(is_counted.sum()), int((is_counted & is_right).sum())
    return {"truth": truth, "right": right, "recall": ratio(right, truth)}
