import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.evaluation.detection.calibration import calibration_figures

DETECTIONS = st.lists(st.tuples(st.floats(0, 1, width=32), st.booleans()), max_size=60)


@given(DETECTIONS)
def test_equal_to_the_definition(detections: list[tuple[float, bool]]) -> None:
    scores = np.array([score for score, _ in detections], np.float32)
    figures = calibration_figures(scores, np.array([right for _, right in detections], np.bool_))
    gaps, table = [], figures["reliability"]
    assert isinstance(table, list)
    for row in range(10):
        inside = [
            (score, right)
            for score, right in detections
            if row <= 10 * score < row + 1 or (row == 9 and score == 1)  # the last bin holds its upper end
        ]
        assert table[row]["count"] == len(inside)
        if inside:
            mean, share = np.mean([score for score, _ in inside]), np.mean([right for _, right in inside])
            assert table[row]["mean_score"] == pytest.approx(mean, abs=1e-9)
            assert table[row]["right"] == pytest.approx(share, abs=1e-9)
            gaps.append((len(inside), abs(mean - share)))
        else:
            assert table[row]["mean_score"] is table[row]["right"] is None
    if not detections:
        assert figures["ece"] is figures["mce"] is figures["brier"] is None
        return
    n = len(detections)
    assert figures["ece"] == pytest.approx(sum(count * gap for count, gap in gaps) / n, abs=1e-9)
    assert figures["mce"] == pytest.approx(max(gap for _, gap in gaps), abs=1e-9)
    assert figures["brier"] == pytest.approx(sum((score - right) ** 2 for score, right in detections) / n, abs=1e-9)


def test_scores_that_are_probabilities() -> None:
    rng = np.random.default_rng(0)
    scores = rng.random(200_000).astype(np.float32)
    figures = calibration_figures(scores, rng.random(200_000) < scores)
    assert figures["ece"] == pytest.approx(0.0, abs=5e-3)
    assert figures["brier"] == pytest.approx(1 / 6, abs=5e-3)
