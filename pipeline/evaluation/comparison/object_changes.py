"""The objects of a source or camera in one frame of two results: which are the same, and how those differ."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Literal, NamedTuple, TypeVar

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Array, Bools, Indices
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.geometry.boxes import iou_xyxy, wrap_angle
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.evaluation.assignment import assign_heaviest
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, SourceBoxes

Kind = Literal["lost", "new", "moved", "turned", "resized", "relabelled", "rescored", "reidentified"]
"""Kind of difference of an object in the second result B from the first one A.

`lost` is in A alone, `new` in B alone; `reidentified`: its track goes on under the id of another one.
"""

KINDS: tuple[Kind, ...] = ("lost", "new", "moved", "turned", "resized", "relabelled", "rescored", "reidentified")
PAIR_KINDS: tuple[Kind, ...] = KINDS[2:]
"""Kinds of differences of an object that both results have."""

TOLERANCES = {"position_m": 0.01, "yaw_deg": 0.5, "size_m": 0.01, "score": 0.01, "pixels": 1.0}
"""Largest differences that count as equal: of a centre, a heading, a length, a score, and an edge of a 2D box."""

MIN_IOU = 0.3
"""Minimum IoU of two 2D boxes that can be the same one."""

CLASS_COST = 0.1
"""Cost of pairing objects of different classes, as a share of the gate."""

APPEARANCE_COST = 0.01
"""Cost of the most different heading, size and score, as a share of the gate: decides between objects in one place."""

ID_GAIN = 0.1
"""Gain of pairing objects of the same track id, as a share of the gate."""

ROUNDING = 1e-6
"""Slack of tolerances: scores are single precision, where 0.2 - 0.1 is more than 0.1."""

ROUNDING_PX = 1e-3
"""Slack of the tolerance of pixels, which are single precision."""

Boxes = TypeVar("Boxes", Boxes3D, Boxes2D)


class KnownClasses(NamedTuple):
    """The classes of one result in terms of both."""

    rows: Indices  # (C,) row in the names of both, by class id of the result
    lengths_m: F64  # (C,) typical length, by class id

    @classmethod
    def of(cls, priors: Sequence[ClassPrior], names: Sequence[str]) -> "KnownClasses":
        """The classes of a result, among the names of both."""
        rows = [names.index(prior.name) for prior in priors]
        return cls(np.array(rows, np.intp), np.array([prior.size_m[0] for prior in priors], np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Objects(Generic[Boxes]):
    """Objects of one source, or 2D boxes of one camera."""

    boxes: Boxes
    track_ids: I64  # (N,) ids, or `UNKNOWN`
    classes: Indices  # (N,) rows of the names of both results
    places: F64  # (N, 3) centres in metres, or (N, 2) in pixels
    reaches: F64  # (N,) how far each can come from one frame to the next: the length of its class, or its longer side


def source_objects(found: SourceBoxes, known: KnownClasses) -> Objects[Boxes3D]:
    """Objects of one source; `known` are the classes of their result."""
    boxes = found.boxes
    classes, lengths_m = known.rows[boxes.class_ids], known.lengths_m[boxes.class_ids]
    return Objects(boxes, found.track_ids, classes, boxes.centers, lengths_m)


def image_objects(found: Boxes2D, known: KnownClasses) -> Objects[Boxes2D]:
    """2D boxes of one camera; `known` are the classes of their result."""
    low, high = np.split(found.xyxy.astype(np.float64), 2, axis=1)
    ids = np.full(len(found), UNKNOWN, np.int64)
    return Objects(found, ids, known.rows[found.class_ids], (low + high) / 2, (high - low).max(1, initial=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """The objects of one channel in one frame of both results."""

    first: Indices  # (M,) row in A of each object that both have
    second: Indices  # (M,) its row in B
    lost: Indices  # Rows in A of the objects that only A has
    new: Indices  # Rows in B of the objects that only B has
    # (M, 6) how far each object differs, by `PAIR_KINDS`: metres (pixels of a 2D box), degrees, metres, 1 for another
    # class, score, 1 for the id of another track
    amounts: F64
    is_changed: Bools  # (M, 6) whether that is more than what counts as equal


class Tracks:
    """Tracks of A and B that are one object: ids are names, and two results may name the same object differently."""

    def __init__(self) -> None:
        self._of_first: dict[int, int] = {}
        self._of_second: dict[int, int] = {}

    def are_broken(self, first: I64, second: I64) -> Bools:
        """(M,) whether an object of A and B goes on under an id that was another object's before; takes in the pairs.

        They are the ids (M,) in A and in B of the objects that both have, `UNKNOWN` where one has none.
        """
        pairs = list(zip(first.tolist(), second.tolist(), strict=True))
        broken = [
            UNKNOWN not in (a, b) and (self._of_first.get(a, b) != b or self._of_second.get(b, a) != a)
            for a, b in pairs
        ]
        for a, b in pairs:
            if UNKNOWN not in (a, b):
                self._of_first[a], self._of_second[b] = b, a
        return np.array(broken, np.bool_)


def pairs_of_least_cost(costs: F64) -> tuple[Indices, Indices]:
    """Rows and columns of the assignment with the smallest sum of costs (N, M), where whoever stays alone costs 1/2.

    A pair that costs 1 is no better than none. The rows rise.
    """
    rows, columns = np.nonzero(costs < 1)
    chosen = assign_heaviest(rows, columns, 1 - costs[rows, columns])
    return rows[chosen], columns[chosen]


def source_changes(first: Objects[Boxes3D], second: Objects[Boxes3D], tracks: Tracks) -> Changes:
    """Differences of the objects of one source; `tracks` are those of the source, up to this frame.

    They are paired so that the sum of the distances, as shares of the gate, is smallest; who stays alone counts like
    half a gate, so that nobody has to move far to make room. Where an object is counts more than its id, because ids
    are given anew in each run: equal ones bring two objects nearer by a tenth of the gate.
    """
    a, b = first.boxes, second.boxes
    gates_m = np.maximum(first.reaches[:, None], second.reaches)
    distances = np.linalg.norm(a.centers[:, None] - b.centers, axis=-1) / gates_m
    sizes = a.sizes[:, None]
    resized = np.abs(sizes - b.sizes).max(-1) / np.maximum(np.maximum(sizes, b.sizes).max(-1), 1e-9)
    turned = np.abs(wrap_angle(a.yaws[:, None] - b.yaws)) / np.pi
    looks = (turned + resized + _apart(a.scores[:, None], b.scores)) / 3
    ids = first.track_ids[:, None]
    same_id = (ids == second.track_ids) & (ids != UNKNOWN)
    costs = distances + APPEARANCE_COST * looks - ID_GAIN * same_id
    i, j = _paired(first, second, costs)
    measured = [
        (np.linalg.norm(a.centers[i] - b.centers[j], axis=1), TOLERANCES["position_m"]),
        (np.degrees(np.abs(wrap_angle(a.yaws[i] - b.yaws[j]))), TOLERANCES["yaw_deg"]),
        (_apart(a.sizes[i], b.sizes[j]).max(1, initial=0.0), TOLERANCES["size_m"]),
        (first.classes[i] != second.classes[j], 0.0),
        (_apart(a.scores[i], b.scores[j]), TOLERANCES["score"]),
        (tracks.are_broken(first.track_ids[i], second.track_ids[j]), 0.0),
    ]
    return _changes(i, j, len(a), len(b), measured)


def image_changes(first: Objects[Boxes2D], second: Objects[Boxes2D]) -> Changes:
    """Differences of the 2D boxes of one image; they have neither heading nor size of their own, nor tracks.

    They are paired as objects are, with what their IoU lacks to 1 for a distance.
    """
    a, b = first.boxes, second.boxes
    is_equal = (a.xyxy[:, None] == b.xyxy).all(-1)  # also without an area
    lack = np.where(is_equal, 0.0, 1 - iou_xyxy(a.xyxy, b.xyxy)) / (1 - MIN_IOU)
    i, j = _paired(first, second, lack + APPEARANCE_COST * _apart(a.scores[:, None], b.scores))
    nothing = np.zeros(len(i)), 0.0
    measured = [
        (_apart(a.xyxy[i], b.xyxy[j]).max(1, initial=0.0), TOLERANCES["pixels"] + ROUNDING_PX),
        nothing,
        nothing,
        (first.classes[i] != second.classes[j], 0.0),
        (_apart(a.scores[i], b.scores[j]), TOLERANCES["score"]),
        nothing,
    ]
    return _changes(i, j, len(a), len(b), measured)


def _paired(first: Objects[Boxes], second: Objects[Boxes], costs: F64) -> tuple[Indices, Indices]:
    return pairs_of_least_cost(costs + CLASS_COST * (first.classes[:, None] != second.classes))


def _apart(first: Array, second: Array) -> F64:
    return np.abs(first.astype(np.float64) - second.astype(np.float64))


def _changes(first: Indices, second: Indices, n: int, m: int, measured: list[tuple[Array, float]]) -> Changes:
    amounts = np.column_stack([amount for amount, _ in measured]).astype(np.float64)
    largest = np.array([allowed for _, allowed in measured])
    lost, new = np.setdiff1d(np.arange(n), first), np.setdiff1d(np.arange(m), second)
    return Changes(first, second, lost, new, amounts, amounts > largest + ROUNDING)
