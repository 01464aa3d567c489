"""Memory of a run about its cameras: the recall of each, and their latest evidence.

A missing 2D box counts against an object as far as the camera should have found it. That share differs between
networks, between day and night, and between a clean and a dirty lens, so it is counted on objects that the other
sensors are sure of. A prior holds until there are many of them.

Cameras are often slower than lidars, and than each other. In frames without the image of a camera, its latest evidence
counts for a while: else an object that only it confirms would come and go with every other frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, Bools, Indices, Table, join_rows
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.detectors.log_odds import logit, sigmoid
from lidcam.pipeline.fusion.assignment import assign
from lidcam.pipeline.fusion.belief.odds import MAX_RECALL
from lidcam.pipeline.fusion.belief.visibility import Visibility

SIZE_EDGES_PX = (12.0, 24.0, 48.0, 96.0)
"""Edges of the size bins of recall: geometric means of width and height in the image, pixels."""

PRIOR_RECALL = (0.2, 0.45, 0.75, 0.9, 0.93)
"""Prior recall by size: between those of a small network and of the simulator's detector."""

PRIOR_WEIGHT = 20.0
"""Weight of the prior, in objects; also that of all cameras together against one camera."""

MAX_COUNTED = 400.0
"""Maximum number of objects per size bin and camera; older ones fade, so that recall follows day and night."""

MIN_OTHER_BELIEF = 0.7
"""Minimum probability of a counted object without the camera."""

MIN_VISIBLE_SHARE = 0.7
"""Minimum visible share of a counted object in the image."""

TURNS_BLIND, STAYS_BLIND = 0.002, 0.95
"""Probabilities that a camera that sees, and one that is blind (covered, dazzled, dark), is blind in the next frame."""

MAX_BLIND_LOG_ODDS = 50.0
"""Maximum absolute log odds of a blind camera."""

HALF_LIFE_S = 0.3
"""Half-life of the weight of evidence, seconds."""

MAX_AGE_S = 1.0
"""Maximum age of evidence, seconds."""

MAX_PEDESTRIAN_LENGTH_M = 1.0
"""Maximum length of classes that move on foot, metres."""

MAX_FOOT_SPEED_M_S, MAX_WHEEL_SPEED_M_S = 3.0, 15.0
"""Maximum speeds on foot and on wheels, m/s."""

MAX_STANDING_DISTANCE = 0.1
"""Maximum distance between two boxes of a standing object, as a share of the class length."""

MAX_SIZE_RATIO = 3.0
"""Maximum ratio of the sides of one object in two frames: the hidden part of it changes."""

MIN_GATE_M = 1e-6
"""Minimum gate by which distances are divided, metres."""

IMPOSSIBLE_COST = 1e6
"""Cost of a pair that cannot be one object."""


class RecallCounts:
    """Counts of found and missed objects by camera, of which these are the names, and size."""

    def __init__(self, cameras: Sequence[str]) -> None:
        self._rows = {name: row for row, name in enumerate(cameras)}
        self._seen = np.zeros((len(cameras), len(PRIOR_RECALL)))
        self._found = np.zeros_like(self._seen)
        self._blind = np.zeros(len(cameras))

    def plain(self, visibility: Visibility) -> F64:
        """(C, N) recall of each camera for objects of the size of each box in plain view, as counted so far."""
        rows = np.array([self._rows[name] for name in visibility.cameras], np.intp)
        of_all = self._found.sum(0) + PRIOR_WEIGHT * np.array(PRIOR_RECALL)
        of_all /= self._seen.sum(0) + PRIOR_WEIGHT
        table = (self._found + PRIOR_WEIGHT * of_all) / (self._seen + PRIOR_WEIGHT)  # cameras, sizes
        return np.asarray(table[rows[:, None], _bins(visibility.size_px)])

    def learn(self, visibility: Visibility, others: F64) -> F64:
        """Count found and missed objects that the other sensors are sure of.

        A camera may be blind for a while: then its 2D boxes are all false, and what it misses says nothing. It is so as
        probable as by the objects that it should have found (a hidden Markov model of two states).

        Args:
            visibility: How C cameras see N boxes.
            others: (C, N) probability of each box without each camera.

        Returns:
            (C, 1) probability that each camera sees.
        """
        rows = np.array([self._rows[name] for name in visibility.cameras], np.intp)
        is_plain = visibility.in_view & ~visibility.is_cut & (visibility.visible >= MIN_VISIBLE_SHARE)
        counted = (is_plain & (others >= MIN_OTHER_BELIEF)).nonzero()
        recall = np.minimum(self.plain(visibility), MAX_RECALL)[counted] * ~visibility.is_matched[counted]
        missed = np.bincount(counted[0], np.log1p(-others[counted] * recall), len(rows))
        before = TURNS_BLIND + (STAYS_BLIND - TURNS_BLIND) * self._blind[rows]
        log_odds = logit(before) + visibility.log_false - missed
        self._blind[rows] = sigmoid(log_odds.clip(-MAX_BLIND_LOG_ODDS, MAX_BLIND_LOG_ODDS))
        sees = 1 - self._blind[rows]
        cells = rows[counted[0]] * len(PRIOR_RECALL) + _bins(visibility.size_px[counted])
        weights = others[counted] * sees[counted[0]]
        self._seen += np.bincount(cells, weights, self._seen.size).reshape(self._seen.shape)
        self._found += np.bincount(cells, weights * visibility.is_matched[counted], self._found.size).reshape(
            self._seen.shape
        )
        kept = MAX_COUNTED / np.maximum(self._seen, MAX_COUNTED)
        self._seen *= kept
        self._found *= kept
        return np.asarray(sees[:, None])


def _bins(size_px: F64) -> Indices:
    return np.searchsorted(SIZE_EDGES_PX, size_px, side="right")


@dataclass(frozen=True, slots=True, eq=False)
class _Remembered(Table):
    """M boxes, and what C cameras said of them."""

    age_s: F64  # (M,) age of the box, seconds
    centers: F64  # (M, 3) in the site frame as it stands now
    sizes: F64  # (M, 3)
    class_ids: I32  # (M,)
    evidence: F64  # (M, C) log likelihood ratio by each camera
    evidence_age_s: F64  # (M, C) its age, seconds; infinite where a camera said nothing


class Memory:
    """The latest evidence of each camera about each object. Frames must come in order."""

    def __init__(self, priors: Sequence[ClassPrior], camera_count: int) -> None:
        length_m = np.array([prior.size_m[0] for prior in priors])
        walks = length_m < MAX_PEDESTRIAN_LENGTH_M
        self._max_speed_m_s = np.where(walks, MAX_FOOT_SPEED_M_S, MAX_WHEEL_SPEED_M_S)
        self._standing_m = MAX_STANDING_DISTANCE * length_m
        boxes, cameras = np.zeros((0, 3)), np.zeros((0, camera_count))
        self._known = _Remembered(np.zeros(0), boxes, boxes, np.zeros(0, np.int32), cameras, cameras)

    def advance(self, seconds: float, T_now_then: F64 | None) -> None:
        """Go on to the next frame.

        Args:
            seconds: Time since the last frame.
            T_now_then: (4, 4) from the site frame as it stood then to as it stands now; None if unknown, which clears
                the memory.
        """
        known, age_s = self._known, self._known.age_s + seconds
        keep = (age_s >= 0) & (age_s <= MAX_AGE_S) & (T_now_then is not None)
        T = np.eye(4) if T_now_then is None else T_now_then
        x, y, z = known.centers.T[:, :, None]
        centers = x * T[:3, 0] + y * T[:3, 1] + z * T[:3, 2] + T[:3, 3]
        evidence_age_s = known.evidence_age_s + seconds
        self._known = replace(known, age_s=age_s, centers=centers, evidence_age_s=evidence_age_s).select(keep)

    def recalled(self, boxes: Boxes3D, is_asked: Bools) -> F64:
        """(C, N) remembered log likelihood ratios of C cameras about N boxes; 0 where not asked for (C, N)."""
        evidence, asked = np.zeros(is_asked.shape), np.flatnonzero(is_asked.any(0))
        if not len(asked):
            return evidence
        rows, known = self._pairs(boxes.select(asked))
        age_s = self._known.evidence_age_s[known].T
        faded = self._known.evidence[known].T * 0.5 ** (age_s / HALF_LIFE_S)
        evidence[:, asked[rows]] = np.where(is_asked[:, asked[rows]] & (age_s <= MAX_AGE_S), faded, 0.0)
        return evidence

    def remember(self, boxes: Boxes3D, is_seen: Bools, evidence: F64, look: Bools) -> None:
        """Replace earlier evidence of the cameras that look in this frame; that of the others is kept.

        Args:
            boxes: N boxes.
            is_seen: (C, N) whether each is in view of each camera.
            evidence: (C, N) log likelihood ratios.
            look: (C,) whether each camera has an image in this frame.
        """
        seen = np.flatnonzero(is_seen.any(0))
        new = _Remembered(
            age_s=np.zeros(len(seen)),
            centers=boxes.centers[seen],
            sizes=boxes.sizes[seen],
            class_ids=boxes.class_ids[seen],
            evidence=evidence[:, seen].T.copy(),
            evidence_age_s=np.where(is_seen[:, seen].T, 0.0, np.inf),
        )
        if not look.all():
            rows, known = self._pairs(boxes.select(seen))
            absent = np.ix_(rows, ~look)
            new.evidence[absent] = self._known.evidence[known][:, ~look]
            new.evidence_age_s[absent] = self._known.evidence_age_s[known][:, ~look]
            keep = np.ones(len(self._known), np.bool_)
            keep[known] = False
            new = join_rows(new, self._known.select(keep))
        self._known = new

    def _pairs(self, boxes: Boxes3D) -> tuple[Indices, Indices]:
        """Rows of boxes and of remembered boxes that are one object, each at most once: the nearest of one class."""
        known = self._known
        distance_m = np.sqrt(((boxes.centers[:, None, :2] - known.centers[:, :2]) ** 2).sum(2))
        gate_m = self._standing_m[known.class_ids] + self._max_speed_m_s[known.class_ids] * known.age_s
        ratio = np.abs(np.log(boxes.sizes[:, None] / known.sizes)).max(2)
        same_class = boxes.class_ids[:, None] == known.class_ids
        fits = (distance_m <= gate_m) & (ratio <= np.log(MAX_SIZE_RATIO)) & same_class
        rows, columns = assign(np.where(fits, distance_m / np.maximum(gate_m, MIN_GATE_M), IMPOSSIBLE_COST))
        is_one = fits[rows, columns]
        return rows[is_one], columns[is_one]
