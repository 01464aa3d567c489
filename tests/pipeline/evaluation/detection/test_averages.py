"""Average precision against its definition, written out in loops."""

import numpy as np
import pytest
from evaluation_frames import evaluated, source_boxes, truth_boxes
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.rotated_iou import ious
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame

NAMES = ("car", "van")
CONFIG = Config(
    classes=tuple(ClassPrior(name=name, size_m=(4.0, 2.0, 1.5), max_size_m=(9.0, 9.0, 9.0)) for name in NAMES),
    evaluate=EvaluateConfig(iou=(0.3, 0.6)),
)
Detections = list[tuple[float, bool]]
RECALLS = [k / 40 for k in range(1, 41)]


def plain_ap(detections: Detections, truth: int) -> float | None:
    """Mean of the best precision at each recall or above; of detections: score, and whether it is right."""
    if truth == 0:
        return None
    read = []
    for recall in RECALLS:
        best = 0.0
        for threshold in {score for score, _ in detections}:
            reported = [is_right for score, is_right in detections if score >= threshold]
            if sum(reported) / truth >= recall - 1e-12:
                best = max(best, sum(reported) / len(reported))
        read.append(best)
    return sum(read) / len(read)


def plain_matches(frame: EvaluationFrame, class_id: int, measure: str, limit: float) -> Detections:
    """Score of each detection of a frame, and whether it shows an object."""
    truth, boxes = frame.truth, frame.sources["lidar"].boxes
    assert truth is not None
    overlaps = getattr(ious(boxes, truth), measure)
    rows = [row for row in range(len(boxes)) if boxes.class_ids[row] == class_id]
    free = {row for row in range(len(truth)) if truth.class_ids[row] == class_id}
    matches: Detections = []
    for row in sorted(rows, key=lambda row: (boxes.scores[row], row), reverse=True):
        possible = [column for column in free if overlaps[row, column] >= limit]
        best = max(possible, key=lambda column: (overlaps[row, column], -column), default=None)
        free -= {best}
        matches.append((float(boxes.scores[row]), best is not None))
    return matches


def random_frames(seed: int, score_steps: int) -> list[EvaluationFrame]:
    rng = np.random.default_rng(seed)
    frames = []
    for index in range(int(rng.integers(1, 5))):
        n, extra = int(rng.integers(0, 6)), int(rng.integers(0, 4))
        ids = rng.integers(0, 2, n)
        centers = rng.uniform(-6, 6, (n, 3)) * (1, 1, 0.05)
        sizes = rng.uniform(0.7, 1.3, (n, 3)) * (4, 2, 1.5)
        yaws = rng.uniform(-3, 3, n)
        truth = truth_boxes(np.c_[centers, sizes, yaws], class_ids=ids)
        rows = np.flatnonzero(rng.random(n) < 0.8)
        moved = centers[rows] + rng.normal(0, 0.3, (len(rows), 3)), sizes[rows] * rng.uniform(0.8, 1.2, (len(rows), 3))
        near = np.c_[moved[0], moved[1], yaws[rows] + rng.normal(0, 0.3, len(rows))]
        false = np.c_[rng.uniform(-6, 6, (extra, 3)), np.full((extra, 3), 2.0), np.zeros(extra)]
        found = source_boxes(
            np.r_[near, false],
            scores=np.round(rng.random(len(rows) + extra) * score_steps) / score_steps,
            class_ids=np.concatenate([ids[rows], rng.integers(0, 2, extra)]),
        )
        frames.append(EvaluationFrame(index, index, truth, {"lidar": found}))
    return frames


@given(seed=st.integers(0, 2**32 - 1), score_steps=st.sampled_from([4, 1000]))
def test_equal_to_the_definition(seed: int, score_steps: int) -> None:
    frames = random_frames(seed, score_steps)
    figures = evaluated(frames, CONFIG)["sources"]["lidar"]
    means: dict[str, list[float]] = {}
    for class_id, name in enumerate(NAMES):
        count = sum(int((frame.truth.class_ids == class_id).sum()) for frame in frames if frame.truth is not None)
        for view, measure in (("bev", "bev"), ("3d", "volume")):
            for iou in (0.3, 0.6):
                matches = [match for frame in frames for match in plain_matches(frame, class_id, measure, iou)]
                key = f"ap_{view}_r40_{100 * iou:.0f}"
                expected = plain_ap(matches, count)
                assert figures[name][key] == pytest.approx(expected, abs=1e-6), (name, key)
                means.setdefault(key, []).extend([] if expected is None else [expected])
    for key, values in means.items():
        assert figures["all"][key] == (pytest.approx(np.mean(values), abs=1e-6) if values else None)
