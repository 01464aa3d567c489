"""Tracks side by side on one recording: frames by themselves, AB3DMOT, and lidcam's own tracks.

AB3DMOT is stated anew here over the fused objects of frames by themselves, in the fixed frame, with a gate that goes
with the length of the class.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pages import table

from lidcam.cli.printing.numbers import NONE, number, percent, share
from lidcam.evaluation.evaluators import measure
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.assignment import assign_nearest
from lidcam.pipeline.evaluation.detection.detection_evaluation import DetectionEvaluation
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, SourceBoxes
from lidcam.pipeline.evaluation.tracking.tracking_evaluation import TrackingEvaluation
from lidcam.readers.results.result import open_result
from lidcam.readers.truth.open import open_truth

Tree = Mapping[str, Any]

SOURCE = "fused"  # the source whose boxes are tracked

GATE, MIN_HITS, MAX_AGE = 0.5, 3, 2
"""Gate of AB3DMOT in lengths, boxes before a track is reported, and frames without one to its end."""

CLASSES = ("all", "car")  # classes that have rows; where cars are the only class, they are all
UNFILTERED = "unfiltered"  # the objects of each frame by itself

FOUND: Mapping[str, Callable[[Tree], str]] = {
    "recall": lambda one: share(one["recall"]),
    "precision": lambda one: share(one["precision"]),
    "false": lambda one: share(one["false_per_frame"]),
    "position": lambda one: number(one["errors"]["position_bev_m"]["rmse"], 3),
    "yaw": lambda one: number(one["errors"]["heading_mod_180_deg"]["rmse"], 1),
    "flips": lambda one: percent(one["errors"]["flips"]),
    "flips, moving": lambda one: percent(one["errors"]["flips_moving"]),
    "speed": lambda one: number(one["errors"]["velocity_m_s"]["rmse"], 2),
    "in 95 %": lambda one: percent(one["errors"]["nees"]["inside_95"]),
}
FOLLOWED: Mapping[str, Callable[[Tree], str]] = {
    "false tracks": lambda one: str(one["false_tracks"]),
    "HOTA": lambda one: share(one["hota"]),
    "MOTA": lambda one: share(one["mota"]),
    "IDF1": lambda one: share(one["idf1"]),
    "switches": lambda one: str(one["id_switches"]),
    "fragments": lambda one: str(one["fragmentations"]),
}
"""Columns of figures that need no tracks, and of those that do."""


def measured_tracks(unfiltered: Path, tracked: Mapping[str, Path]) -> Tree:
    """`sources` and `tracking` of a result without tracks, whose truth counts, and of others with tracks, by name."""
    with ExitStack() as stack:
        result = stack.enter_context(open_result(unfiltered))
        truth = stack.enter_context(open_truth(result))
        frames = [replace(frame, images={}) for frame in EvaluationFrames(result, truth)]
        config = result.config
        found = {name: _fused(path) for name, path in tracked.items()}
    compared = (_beside(*pair, found) for pair in zip(frames, ab3dmot(frames, config), strict=True))
    return measure(compared, (DetectionEvaluation(config, ()), TrackingEvaluation(config)))


def _fused(path: Path) -> dict[int, SourceBoxes]:
    """The fused objects of a result by stamp."""
    with open_result(path) as result:
        return {frame.stamp_ns: frame.sources[SOURCE] for frame in result.frames() if SOURCE in frame.sources}


def _beside(
    frame: EvaluationFrame, filtered: SourceBoxes, found: Mapping[str, Mapping[int, SourceBoxes]]
) -> EvaluationFrame:
    own = {name: by_stamp[frame.stamp_ns] for name, by_stamp in found.items() if frame.stamp_ns in by_stamp}
    others = {UNFILTERED: frame.sources[SOURCE], "AB3DMOT": filtered}
    return replace(frame, sources={**others, **own})


def tracks_table(tree: Tree, ways: Sequence[str]) -> Iterator[str]:
    """The lines of the table: all classes and cars, each with its ways; those of lidcam's own are named."""
    names = (UNFILTERED, "AB3DMOT", *ways)
    sources, tracking = tree["sources"], tree["tracking"]
    with_truth = [name for name, one in sources[UNFILTERED].items() if name != "all" and one["truth"]]
    shown = CLASSES[1:] if with_truth == ["car"] else CLASSES
    rows = []
    for class_name in shown:
        for name in names:
            followed = tracking.get(name, {}).get(class_name)
            rows.append(
                [class_name, name]
                + [cell(sources[name][class_name]) for cell in FOUND.values()]
                + [NONE if followed is None else cell(followed) for cell in FOLLOWED.values()]
            )
    yield from table(["class", "tracks", *FOUND, *FOLLOWED], rows)


def ab3dmot(frames: Sequence[EvaluationFrame], config: Config) -> Iterator[SourceBoxes]:
    """AB3DMOT (Weng et al., 3D multi-object tracking: a baseline and new evaluation metrics, IROS 2020).

    A Kalman filter of constant velocity over x, y, z, yaw, length, width and height with its own covariances, and an
    assignment of least distance, by the centres as in its later versions. Boxes are those of the filter.
    """
    lengths_m = np.array([one.size_m[0] for one in config.classes])
    tracks: list[_Filter] = []
    count = 0
    for index, frame in enumerate(frames):
        boxes, rows = frame.sources[SOURCE].boxes, _ground(frame)
        for track in tracks:
            track.predict()
        states = np.array([track.x for track in tracks]).reshape(-1, 10)
        distances = np.linalg.norm(states[:, None, :3] - rows[None, :, :3], axis=2) / lengths_m[boxes.class_ids]
        same = np.array([track.class_id for track in tracks], np.int32)[:, None] == boxes.class_ids
        first, second = np.nonzero(same & (distances <= GATE))
        chosen = assign_nearest(first, second, distances[first, second])
        for track_row, row in zip(first[chosen].tolist(), second[chosen].tolist(), strict=True):
            tracks[track_row].update(rows[row], float(boxes.scores[row]))
        for row in np.setdiff1d(np.arange(len(rows)), second[chosen]).tolist():
            count += 1
            tracks.append(
                _Filter(count, int(boxes.class_ids[row]), float(boxes.scores[row]), np.append(rows[row], [0.0] * 3))
            )
        tracks = [track for track in tracks if track.age < MAX_AGE]
        yield _in_site(frame, [track for track in tracks if track.hits >= MIN_HITS or index < MIN_HITS])


_STEP = np.eye(10)
_STEP[[0, 1, 2], [7, 8, 9]] = 1.0
_NOISE = np.diag([1.0] * 7 + [0.01] * 3)


@dataclass
class _Filter:
    """A track of AB3DMOT: x, y, z, yaw, length, width, height, and the velocity in metres a frame."""

    id: int
    class_id: int
    score: float
    x: F64
    P: F64 = field(default_factory=lambda: np.diag([10.0] * 7 + [1e4] * 3))
    hits: int = 1
    age: int = 0

    def predict(self) -> None:
        self.x = _STEP @ self.x
        self.P = _STEP @ self.P @ _STEP.T + _NOISE
        self.age += 1

    def update(self, measured: F64, score: float) -> None:
        turn = float(wrap_angle(measured[3] - self.x[3]))
        if abs(turn) > np.pi / 2:  # the heading of the box is taken, its axis is filtered
            self.x[3] += np.pi
            turn = float(wrap_angle(turn - np.pi))
        error = measured - self.x[:7]
        error[3] = turn
        gain = self.P[:, :7] @ np.linalg.inv(self.P[:7, :7] + np.eye(7))
        self.x = self.x + gain @ error
        self.P = self.P - gain @ self.P[:7]
        self.hits, self.age, self.score = self.hits + 1, 0, score


def _pose(frame: EvaluationFrame) -> F64:
    if frame.T_fixed_site is None:
        raise ValueError(f"frame {frame.index}: expected a pose of the site frame, found none")
    return frame.T_fixed_site


def _ground(frame: EvaluationFrame) -> F64:
    """(N, 7) x, y, z, yaw, length, width, height of the boxes in the fixed frame."""
    boxes, pose = frame.sources[SOURCE].boxes, _pose(frame)
    places = boxes.centers @ pose[:3, :3].T + pose[:3, 3]
    return np.column_stack([places, boxes.yaws + np.arctan2(pose[1, 0], pose[0, 0]), boxes.sizes])


def _in_site(frame: EvaluationFrame, tracks: Sequence[_Filter]) -> SourceBoxes:
    """The boxes of tracks in the site frame; their covariances mean nothing, and are left out."""
    inverse, n = np.linalg.inv(_pose(frame)), len(tracks)
    states = np.array([track.x for track in tracks]).reshape(-1, 10)
    boxes = Boxes3D(
        frame.stamp_ns,
        frame.sources[SOURCE].boxes.frame_id,
        states[:, :3] @ inverse[:3, :3].T + inverse[:3, 3],
        states[:, 4:7].copy(),
        wrap_angle(states[:, 3] + np.arctan2(inverse[1, 0], inverse[0, 0])),
        np.array([track.score for track in tracks], np.float32),
        np.array([track.class_id for track in tracks], np.int32),
        np.zeros(n, np.int32),
        np.zeros((n, 3, 3)),
        np.zeros(n, np.uint8),
        np.full(n, frame.stamp_ns, np.int64),
    )
    return SourceBoxes(boxes, np.array([track.id for track in tracks], np.int64))
