"""Tables of all frames, with one row for each true object and each detection, and the rows that make a figure."""

from dataclasses import dataclass

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, Bools, Indices, Names, Table

FALSE = -1
"""Stands for the row of a true object where the detection shows none."""

IGNORED = -2
"""Stands for the row of a true object where the detection is neither right nor wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class TruthTable(Table):
    """The true objects of all frames."""

    frames: I32  # (T,) int32, number of the evaluated frame
    class_ids: I32  # (T,) int32, row of the configured classes, or `UNKNOWN`
    labels: Names  # (T,) str, the truth's own names of their classes
    parts: Bools  # (T, P) bool, parts of the site in which it lies
    is_evaluated: Bools  # (T,) bool; False for what is neither a miss nor an error
    track_ids: I64  # (T,) int64, the same for the same object in all frames, or `UNKNOWN`
    poses: F64  # (T, 3) float64, x, y (metres) and yaw over the ground; NaN where not known


@dataclass(frozen=True, slots=True, eq=False)
class FoundTable:
    """The detections of one source in all frames."""

    frames: I32  # (N,) int32, number of the evaluated frame
    class_ids: I32  # (N,) int32, row of the configured classes
    scores: F32  # (N,) float32
    parts: Bools  # (N, P) bool, parts of the site in which it lies
    matches: I32  # (N, K) int32 by criterion, row of the true object that the detection shows; or `FALSE`, `IGNORED`
    errors: F32  # (N, 8) float32, errors of the matches by `Criteria.position`, by `Column`; NaN without a match
    velocities: F32  # (N, 3) float32, along x and y of the ground in m/s, and yaw rate in rad/s; NaN where not known
    is_predicted: Bools  # (N,) bool, whether nothing of the object was seen in this frame


@dataclass(frozen=True, slots=True, eq=False)
class Scored(Table):
    """Detections that count, by falling score."""

    rows: Indices  # (N,) of the found table
    truth_rows: I32  # (N,) int32, the object that each shows; `FALSE` if none
    scores: F32  # (N,) float32
    is_right: Bools  # (N,) bool
    parts: Bools  # (N, P) bool, where a detection counts: at the object that it shows, or else where it is itself

    def within(self, part: int | None) -> "Scored":
        """The detections in a part of the site (None: in all of it)."""
        return self if part is None else self.select(self.parts[:, part])
