"""The worst errors of a result, to look at: what it reports that is not there, and what it misses.

An error lasts: a bench that is taken for a car is taken for one in every frame. Errors of successive frames at one
place, or of one true object, count as one mistake.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from pipeline.core.arrays import F64, I32, Indices
from pipeline.core.detections import Boxes3D
from pipeline.core.settings.config import Config
from pipeline.evaluation.detection.criteria import Criteria
from pipeline.evaluation.detection.matching import match_criteria, match_other_classes
from pipeline.evaluation.detection.tables import FALSE
from pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, Figures, TruthBoxes3D
from pipeline.evaluation.ignoring import is_evaluated, is_within
from pipeline.evaluation.near_objects import Candidates, FoundObjects, TrueObjects, pairs_near

__all__ = ["Mistake", "Mistakes"]

MAX_PAUSE_NS = 2_000_000_000
"""An error that comes back at the same place after a longer pause is another mistake."""

MAX_TOLD = 10
"""Mistakes of each kind among the figures."""

Kind = Literal["false", "missed"]
Cause = Literal["", "nothing", "class", "second", "place"]


@dataclass(frozen=True, slots=True, eq=False)
class Mistake:
    """An error over one or more frames.

    Attributes:
        kind: `false`: there is no object of this class; `missed`: an object that was not found.
        class_name: Class of the detection, or of the missed object.
        label: The class as the truth names it; of a false one, that of the object at the place, if there is one.
        track_id: Id of the true object; of a false one, of the object at the place; `UNKNOWN` if there is none.
        cause: Why it is false: there is `nothing`, the object at the place is of another `class`, it is shown by a
            better detection already (`second`), or the detection is too far from its `place`. Empty of a missed one.
        frames: Number of frames with the error.
        first_ns: Stamp of the first of them.
        last_ns: Stamp of the last of them.
        worst_ns: Stamp of the frame in which the score is highest, or the object has the most lidar points.
        worst_frame: Its number.
        center: (3,) box of that frame: centre, metres in the site frame.
        last_center: (3,) centre in the last frame.
        size_m: Its length, width, height.
        yaw: Its heading, radians.
        score: Score of a false detection in that frame; 0 for a missed object.
        lidar_points: Lidar points of a missed object in that frame; `UNKNOWN` if the truth does not say, and of a
            false detection.
        weight: By which mistakes are ranked: the sum of the scores over the frames, or the number of frames.
    """

    kind: Kind
    class_name: str
    label: str
    track_id: int
    cause: Cause
    frames: int
    first_ns: int
    last_ns: int
    worst_ns: int
    worst_frame: int
    center: F64
    last_center: F64
    size_m: F64
    yaw: float
    score: float
    lidar_points: int
    weight: float

    def figures(self, start_ns: int) -> Figures:
        """As JSON has it, with times in seconds since `start_ns`, too."""
        return {
            "class": self.class_name,
            "label": self.label or None,
            "cause": self.cause or None,
            "frames": self.frames,
            "first_s": round((self.first_ns - start_ns) / 1e9, 3),
            "last_s": round((self.last_ns - start_ns) / 1e9, 3),
            "worst_s": round((self.worst_ns - start_ns) / 1e9, 3),
            "worst_ns": self.worst_ns,
            "worst_frame": self.worst_frame,
            **dict(zip(("x_m", "y_m", "z_m"), np.round(self.center, 3).tolist(), strict=True)),
            **dict(zip(("length_m", "width_m", "height_m"), np.round(self.size_m, 3).tolist(), strict=True)),
            "yaw_deg": round(float(np.degrees(self.yaw)), 1),
            "score": round(self.score, 4) if self.kind == "false" else None,
            "lidar_points": None if self.lidar_points == UNKNOWN else self.lidar_points,
        }


class Mistakes:
    """Collects the errors of one source.

    A detection is right if its centre is within 2 m, scaled by the class's length, of an object of its class; see
    `detection.criteria.Criteria.position`. Memory grows with the number of mistakes, not of frames.

    Args:
        config: Classes and settings of the evaluation.
        source: The source.
    """

    def __init__(self, config: Config, source: str = "fused") -> None:
        self._config, self._source = config, source
        self._criteria = Criteria.of(config)
        self._start_ns: int | None = None
        self._open: list[Mistake] = []
        self._closed: list[Mistake] = []

    def add(self, frame: EvaluationFrame) -> None:
        """Take in one frame; those without truth, or without the source, have no errors."""
        if self._start_ns is None:
            self._start_ns = frame.stamp_ns
        source = frame.sources.get(self._source)
        if frame.truth is None or source is None:
            return
        found, truth, position = source.boxes, frame.truth, self._criteria.position
        counted = is_evaluated(truth, self._config.evaluate)
        pairs = pairs_near(FoundObjects.of([source], 0), TrueObjects.of([truth], 0), self._criteria.scales)
        matches = match_criteria(
            pairs,
            [position],
            position=position,
            found=found,
            truth=truth,
            is_evaluated=counted,
            is_ignored=~is_within(found.centers, self._config.evaluate),
        )[:, 0]
        mistaken = match_other_classes(pairs, position, matches=matches, found=found, truth=truth, is_evaluated=counted)
        at_place = np.where(mistaken >= 0, mistaken, _most_overlapped(pairs, len(found)))
        now = [
            *self._false(frame, found, truth, matches, at_place),
            *self._missed(frame, truth, np.setdiff1d(np.flatnonzero(counted), matches)),
        ]
        before = self._open
        self._open = [mistake for mistake in before if frame.stamp_ns - mistake.last_ns <= MAX_PAUSE_NS]
        self._closed += [mistake for mistake in before if frame.stamp_ns - mistake.last_ns > MAX_PAUSE_NS]
        for mistake in now:
            self._join(mistake)

    def worst(self, kind: Kind, count: int) -> list[Mistake]:
        """The worst mistakes of a kind, the worst first; of equal ones the earlier."""
        known = [mistake for mistake in (*self._closed, *self._open) if mistake.kind == kind]
        return sorted(known, key=lambda one: (-one.weight, one.first_ns, *one.center.tolist()))[:count]

    def figures(self) -> Figures:
        """The worst mistakes of each kind, `MAX_TOLD` at most."""
        kinds: tuple[Kind, ...] = ("false", "missed")
        start_ns = self._start_ns or 0  # without frames there are no mistakes
        told: Figures = {kind: [mistake.figures(start_ns) for mistake in self.worst(kind, MAX_TOLD)] for kind in kinds}
        return {"mistakes": {self._source: told}}

    def _false(
        self, frame: EvaluationFrame, boxes: Boxes3D, truth: TruthBoxes3D, matches: I32, at_place: Indices
    ) -> Iterator[Mistake]:
        for row in np.flatnonzero(matches == FALSE).tolist():
            other = int(at_place[row])
            score = float(boxes.scores[row])
            yield Mistake(
                kind="false",
                class_name=self._config.class_names[boxes.class_ids[row]],
                label=str(truth.labels[other]) if other >= 0 else "",
                track_id=int(truth.track_ids[other]) if other >= 0 else UNKNOWN,
                cause=_cause(other, int(boxes.class_ids[row]), truth, matches),
                score=score,
                lidar_points=UNKNOWN,
                weight=score,
                **_moment(frame, boxes, row),
            )

    def _missed(self, frame: EvaluationFrame, truth: TruthBoxes3D, rows: Indices) -> Iterator[Mistake]:
        for row in rows.tolist():
            yield Mistake(
                kind="missed",
                class_name=self._config.class_names[truth.class_ids[row]],
                label=str(truth.labels[row]),
                track_id=int(truth.track_ids[row]),
                cause="",
                score=0.0,
                lidar_points=int(truth.lidar_points[row]),
                weight=1.0,
                **_moment(frame, truth, row),
            )

    def _join(self, new: Mistake) -> None:
        """Count an error of this frame with the mistake that it continues; it is a mistake of its own without one."""
        known = [row for row, old in enumerate(self._open) if old.last_ns < new.last_ns and self._is_same(old, new)]
        if not known:
            self._open.append(new)
            return
        row = min(known, key=lambda row: (_gap_m(self._open[row], new), row))
        old = self._open[row]
        worst = new if (new.score, new.lidar_points) > (old.score, old.lidar_points) else old
        self._open[row] = replace(
            worst,
            frames=old.frames + 1,
            first_ns=old.first_ns,
            last_ns=new.last_ns,
            last_center=new.center,
            weight=old.weight + new.weight,
        )

    def _is_same(self, old: Mistake, new: Mistake) -> bool:
        if (old.kind, old.class_name) != (new.kind, new.class_name):
            return False
        if new.kind == "missed" and (old.track_id, new.track_id) != (UNKNOWN, UNKNOWN):
            return old.track_id == new.track_id
        class_id = self._config.class_names.index(new.class_name)
        return bool(_gap_m(old, new) <= self._criteria.position.limits[class_id])


def _moment(frame: EvaluationFrame, boxes: Boxes3D | TruthBoxes3D, row: int) -> dict[str, Any]:
    """What a mistake takes from its box."""
    stamp_ns, center = frame.stamp_ns, boxes.centers[row]
    return {
        "frames": 1,
        "first_ns": stamp_ns,
        "last_ns": stamp_ns,
        "worst_ns": stamp_ns,
        "worst_frame": frame.index,
        "center": center,
        "last_center": center,
        "size_m": boxes.sizes[row],
        "yaw": float(boxes.yaws[row]),
    }


def _cause(other: int, class_id: int, truth: TruthBoxes3D, matches: I32) -> Cause:
    """Why a detection is false, by the object at its place, if there is one."""
    if other < 0:
        return "nothing"
    if truth.class_ids[other] != class_id:
        return "class"
    return "second" if other in matches else "place"


def _gap_m(old: Mistake, new: Mistake) -> float:
    return float(np.hypot(*(new.center - old.last_center)[:2]))


def _most_overlapped(pairs: Candidates, count: int) -> Indices:
    """(N,) row of the true object that each detection overlaps most, -1 where it overlaps none."""
    found = np.full(count, UNKNOWN, np.intp)
    order = np.lexsort((-pairs.truth, pairs.bev))
    order = order[pairs.bev[order] > 0]
    found[pairs.found[order]] = pairs.truth[order]  # the largest comes last
    return found
