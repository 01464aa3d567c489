"""Counts, and calibration, against their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.evaluation.detection.counts import calibration_figures, count_figures
from lidcam.pipeline.evaluation.detection.curves import curve_of

DETECTIONS = st.lists(st.tuples(st.floats(0, 1, width=32), st.booleans()), max_size=60)


@given(DETECTIONS, st.integers(0, 4))
def test_counts_are_those_of_all_that_is_reported(rows: list[tuple[float, bool]], missed: int) -> None:
    rows = sorted(rows, reverse=True)
    right = sum(is_right for _, is_right in rows)
    scores = np.array([score for score, _ in rows], np.float32)
    curve = curve_of(scores, np.array([is_right for _, is_right in rows], np.bool_), right + missed)
    counts = count_figures(curve, 2, 3)
    assert counts["found"] == len(rows) + 2
    assert (counts["ignored"], counts["truth_ignored"], counts["missed"]) == (2, 3, missed)
    assert counts["precision"] == (pytest.approx(right / len(rows)) if rows else None)
    assert counts["f1"] == (pytest.approx(2 * right / (len(rows) + right + missed)) if right + missed else None)


@given(DETECTIONS)
def test_calibration_is_equal_to_its_definition(detections: list[tuple[float, bool]]) -> None:
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
        assert figures["ece"] is None
        return
    n = len(detections)
    assert figures["ece"] == pytest.approx(sum(count * gap for count, gap in gaps) / n, abs=1e-9)
