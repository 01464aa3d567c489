"""The curves of samples are read at a bounded number of scores."""

import numpy as np
import pytest

from pipeline.evaluation.detection.by_distance import interpolated_ap, points_of
from pipeline.evaluation.detection.curves import R40, average_precision, curve_of
from pipeline.evaluation.detection.gain.resampling import Resampling, sampled_ap_by_distance, sampled_ap_by_overlap


def detections(count: int, truth: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    scores = np.sort(rng.random(count).astype(np.float32))[::-1]
    is_right = rng.random(count) < 0.2 + 0.7 * scores
    frames = rng.integers(0, 50, count).astype(np.int32)
    return scores, is_right, frames, rng.integers(0, 50, truth).astype(np.int32)


WHOLE = Resampling(np.zeros(50, np.int64), np.ones((1, 1)))


@pytest.mark.parametrize(("count", "tolerance"), [(0, 0.0), (1, 1e-12), (300, 1e-12), (40_000, 2e-3)])
def test_a_sample_that_is_the_whole_recording(count: int, tolerance: float) -> None:
    scores, is_right, frames, truth_frames = detections(count, 30_000 if count > 300 else 250)
    curve = curve_of(scores, is_right, len(truth_frames))
    exact = average_precision(curve.right, curve.precision, len(truth_frames), R40)
    sampled = sampled_ap_by_overlap(WHOLE, frames, scores, is_right, truth_frames)
    assert sampled == pytest.approx([exact], abs=tolerance)
    exact = interpolated_ap(*points_of(is_right, len(truth_frames)))
    sampled = sampled_ap_by_distance(WHOLE, frames, is_right, truth_frames)
    assert sampled == pytest.approx([exact], abs=tolerance)


def test_no_figure_without_true_objects() -> None:
    scores, is_right, frames, _ = detections(10, 0)
    none = np.zeros(0, np.int32)
    assert np.isnan(sampled_ap_by_overlap(WHOLE, frames, scores, is_right, none)).all()
    assert np.isnan(sampled_ap_by_distance(WHOLE, frames, is_right, none)).all()
