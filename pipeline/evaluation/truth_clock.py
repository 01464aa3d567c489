"""By how much the stamps of the truth are off: if so, objects that move are found ahead of it or behind it."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import MIN_MOVING_SPEED_M_S
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, Figures, in_order
from lidcam.pipeline.evaluation.true_motion import ground_poses, true_velocities

OFFSETS_S = np.arange(-50, 51) / 20
"""Offsets that are tried."""

MIN_OFFSET_S, MIN_MOVING, MIN_SHARE, MIN_GAIN = 0.1, 20, 0.3, 1.2
"""Minimum offset that is told, number of moving objects in all frames, score for each, and score over that without."""

REACH = 0.25
"""Distance at which a detection scores nothing, in lengths of the true object; it scores 1 at the object's centre."""


class TruthClock:
    """Finds the offset at which most detections lie where the true objects were then; an `Evaluator`."""

    def __init__(self, config: Config) -> None:
        self._known_s = config.evaluate.truth_offset_ms / 1000
        self._stamps_ns: list[int] = []
        self._truth: list[tuple[I32, I64, F64, F64]] = []  # classes, tracks, poses over the ground, lengths
        self._found: list[F64] = []  # (N, 2) places over the ground in metres, of the last source

    def add_frame(self, frame: EvaluationFrame) -> None:
        """Take in one frame."""
        if frame.truth is None or frame.T_fixed_site is None or not frame.sources:
            return
        truth, found = frame.truth, frame.sources[in_order(frame.sources)[-1]].boxes
        poses = [
            ground_poses(boxes.centers, boxes.yaws, np.broadcast_to(frame.T_fixed_site, (len(boxes), 4, 4)))
            for boxes in (truth, found)
        ]
        self._stamps_ns.append(frame.stamp_ns)
        self._truth.append((truth.class_ids, truth.track_ids, poses[0], truth.sizes[:, 0]))
        self._found.append(poses[1][:, :2])

    def figures(self) -> Figures:
        """`truth_offset_s`: stamps of the truth minus the time at which it holds; None: not known, or small."""
        return {"truth_offset_s": self._offset_s()}

    def _offset_s(self) -> float | None:
        if not self._truth:
            return None
        frames = np.repeat(np.arange(len(self._truth), dtype=np.int32), [len(classes) for classes, *_ in self._truth])
        classes, tracks, poses, lengths_m = map(np.concatenate, zip(*self._truth, strict=True))
        velocities = true_velocities(frames, np.array(self._stamps_ns, np.int64), classes, tracks, poses)[:, :2]
        rows = np.flatnonzero(np.hypot(*velocities.T) >= MIN_MOVING_SPEED_M_S)
        score = np.zeros(len(OFFSETS_S))
        for row in rows.tolist():
            places = poses[row, :2] + OFFSETS_S[:, None] * velocities[row]
            away_m = np.linalg.norm(places[:, None] - self._found[frames[row]], axis=2).min(axis=1, initial=np.inf)
            score += np.maximum(0, 1 - (away_m / (REACH * lengths_m[row])) ** 2)
        best = int(score.argmax())
        is_sure = score[best] >= max(MIN_SHARE * len(rows), MIN_GAIN * score[OFFSETS_S == 0].item())
        if len(rows) < MIN_MOVING or not is_sure or abs(OFFSETS_S[best]) < MIN_OFFSET_S:
            return None
        return self._known_s + float(OFFSETS_S[best])
