"""The worst errors of a result, to look at: what it reports that is not there, and what it misses.

An error lasts: a bench that is taken for a car is taken for one in every frame. Errors of successive frames at one
place, or of one true object, count as one mistake.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, Indices
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.criteria import Criteria
from lidcam.pipeline.evaluation.detection.matching import match_frame, match_other_classes
from lidcam.pipeline.evaluation.detection.tables import FALSE
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame, Figures, TruthBoxes3D
from lidcam.pipeline.evaluation.near_objects import Candidates

MAX_PAUSE_NS = 2_000_000_000
"""Longest pause within one mistake."""

SOURCE = "fused"
MAX_LISTED = 10
"""Largest number of mistakes of each kind among the figures."""

Kind = Literal["false", "missed"]
Cause = Literal["nothing", "class", "second", "place"]
"""Why a detection is false: there is `nothing`, the object at the place is of another `class`, it is shown by a better
detection already (`second`), or the detection is too far from its `place`."""


@dataclass(frozen=True, slots=True, eq=False)
class Mistake:
    """An error over one or more frames."""

    kind: Kind  # `false`: there is no object of this class; `missed`: an object that was not found
    class_id: int  # Class of the detection, or of the missed object
    track_id: int  # Id of the true object; of a false one, of the object at the place; `UNKNOWN` if there is none
    weight: float  # Rank among mistakes: the sum of the scores over the frames, or the number of frames
    frames: int  # Number of frames with the error
    first_ns: int  # Stamp of the first of them
    last_ns: int  # Stamp of the last of them
    last_center: F64  # (3,) centre in the last frame, metres in the site frame
    # Score of a false detection, lidar points of a missed object, in the worst frame: where it is largest
    severity: float
    worst_ns: int  # Stamp of the worst frame
    center: F64  # (3,) centre in the worst frame
    named: Figures  # Class, label and cause in the worst frame, as JSON has them
    box: Figures  # Number, box, score and lidar points of the worst frame, as JSON has them

    def figures(self, start_ns: int) -> Figures:
        """The mistake as JSON has it, with times also in seconds since `start_ns`."""
        return {
            **self.named,
            "frames": self.frames,
            "first_s": round((self.first_ns - start_ns) / 1e9, 3),
            "last_s": round((self.last_ns - start_ns) / 1e9, 3),
            "worst_s": round((self.worst_ns - start_ns) / 1e9, 3),
            "worst_ns": self.worst_ns,
            **self.box,
        }


class Mistakes:
    """Collects the errors of fused objects.

    A detection is right if its centre is within 2 m, scaled by the class's length, of an object of its class; see
    `detection.criteria.Criteria.position`. Memory grows with the number of mistakes, not of frames.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._criteria = Criteria.of(config)
        self._start_ns: int | None = None
        self._open: list[Mistake] = []
        self._closed: list[Mistake] = []

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame; those without truth, or without the source, have no errors."""
        if self._start_ns is None:
            self._start_ns = frame.stamp_ns
        source = frame.sources.get(SOURCE)
        if frame.truth is None or source is None:
            return
        found, truth, position = source.boxes, frame.truth, self._criteria.position
        pairs, matches, counted = match_frame(source, truth, self._criteria, self._config.evaluate)
        mistaken = match_other_classes(pairs, position, matches=matches, found=found, truth=truth, is_evaluated=counted)
        at_place = np.where(mistaken >= 0, mistaken, _most_overlapped(pairs, len(found)))
        false, missed = np.flatnonzero(matches == FALSE), np.setdiff1d(np.flatnonzero(counted), matches)
        now = [self._mistake(frame, found, row, truth, int(at_place[row]), matches) for row in false.tolist()]
        now += [self._mistake(frame, truth, row, truth, row, matches) for row in missed.tolist()]
        before = self._open
        self._open = [mistake for mistake in before if frame.stamp_ns - mistake.last_ns <= MAX_PAUSE_NS]
        self._closed += [mistake for mistake in before if frame.stamp_ns - mistake.last_ns > MAX_PAUSE_NS]
        self._join(now, frame.stamp_ns)

    def worst(self, kind: Kind, count: int) -> list[Mistake]:
        """The worst mistakes of a kind, the worst first; of equal ones the earlier."""
        known = [mistake for mistake in (*self._closed, *self._open) if mistake.kind == kind]
        return sorted(known, key=lambda one: (-one.weight, one.first_ns, *one.center.tolist()))[:count]

    def figures(self) -> Figures:
        """The worst mistakes of each kind, `MAX_LISTED` at most."""
        kinds: tuple[Kind, ...] = ("false", "missed")
        start_ns = self._start_ns or 0  # without frames there are no mistakes
        listed: Figures = {
            kind: [mistake.figures(start_ns) for mistake in self.worst(kind, MAX_LISTED)] for kind in kinds
        }
        return {"mistakes": {SOURCE: listed}}

    def _mistake(
        self,
        frame: EvaluationFrame,
        boxes: Boxes3D | TruthBoxes3D,
        row: int,
        truth: TruthBoxes3D,
        other: int,
        matches: I32,
    ) -> Mistake:
        """A false detection or a missed object; `other` is the true object at its place, -1 if there is none."""
        stamp_ns, class_id, center = frame.stamp_ns, int(boxes.class_ids[row]), boxes.centers[row]
        label, track_id = (str(truth.labels[other]), int(truth.track_ids[other])) if other >= 0 else ("", UNKNOWN)
        score = float(boxes.scores[row]) if isinstance(boxes, Boxes3D) else None
        cause = None if score is None else _cause(other, class_id, truth, matches)
        points = UNKNOWN if score is not None else int(truth.lidar_points[row])
        named = {"class": self._config.class_names[class_id], "label": label or None, "cause": cause}
        box: Figures = {
            "worst_frame": frame.index,
            **dict(zip(("x_m", "y_m", "z_m"), np.round(center, 3).tolist(), strict=True)),
            **dict(zip(("length_m", "width_m", "height_m"), np.round(boxes.sizes[row], 3).tolist(), strict=True)),
            "yaw_deg": round(float(np.degrees(boxes.yaws[row])), 1),
            "score": None if score is None else round(score, 4),
            "lidar_points": None if points == UNKNOWN else points,
        }
        kind: Kind = "missed" if score is None else "false"
        weight, severity = (1.0, points) if score is None else (score, score)
        times_ns = stamp_ns, stamp_ns
        return Mistake(kind, class_id, track_id, weight, 1, *times_ns, center, severity, stamp_ns, center, named, box)

    def _join(self, now: list[Mistake], stamp_ns: int) -> None:
        """Count each error of this frame with the nearest mistake that it continues; else it is one of its own."""
        before = list(self._open)
        keys = np.array([_key(old) for old in before], np.int64).reshape(-1, 3)
        centers = np.array([old.last_center for old in before]).reshape(-1, 3)
        are_free = np.array([old.last_ns < stamp_ns for old in before], np.bool_)
        for new in now:
            gaps_m = np.hypot(*(centers - new.center)[:, :2].T)
            fits = are_free & (keys == _key(new)).all(1)
            if _key(new)[-1] == UNKNOWN:
                fits &= gaps_m <= self._criteria.position.limits[new.class_id]
            if not fits.any():
                self._open.append(new)
                continue
            row = int(np.where(fits, gaps_m, np.inf).argmin())
            old, are_free[row] = before[row], False
            self._open[row] = replace(
                new if new.severity > old.severity else old,
                frames=old.frames + 1,
                first_ns=old.first_ns,
                last_ns=new.last_ns,
                last_center=new.center,
                weight=old.weight + new.weight,
            )


def _key(one: Mistake) -> tuple[bool, int, int]:
    """Key that errors of one mistake share: those of one known true object may be at any distance."""
    return one.kind == "missed", one.class_id, one.track_id if one.kind == "missed" else UNKNOWN


def _cause(other: int, class_id: int, truth: TruthBoxes3D, matches: I32) -> Cause:
    """Why a detection is false, by the object at its place, if there is one."""
    if other < 0:
        return "nothing"
    if truth.class_ids[other] != class_id:
        return "class"
    return "second" if other in matches else "place"


def _most_overlapped(pairs: Candidates, count: int) -> Indices:
    """(N,) row of the true object that each detection overlaps most, -1 where it overlaps none."""
    found = np.full(count, UNKNOWN, np.intp)
    order = np.lexsort((-pairs.truth, pairs.bev))
    order = order[pairs.bev[order] > 0]
    found[pairs.found[order]] = pairs.truth[order]  # the largest comes last
    return found
