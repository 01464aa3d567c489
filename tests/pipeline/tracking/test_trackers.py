from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from detections import boxes3d
from frames import tracks_of

from lidcam.pipeline.core.detections import NO_HYPOTHESIS, Fused
from lidcam.pipeline.tracking.trackers import Confirmations

Words = Mapping[str, Sequence[int]]


def matched(*frames: tuple[float, Words], numbers: Sequence[int] = (7, 4, 0)) -> list[list[int]]:
    """How many cameras confirm objects of hypotheses 0 and 1 and a predicted one, by what they match at times in s."""
    confirmations, found = Confirmations(), []
    for at_s, words in frames:
        rows = np.array([0, 1, NO_HYPOTHESIS])[: len(numbers)]
        counts = np.array([sum(row in said for said in words.values()) for row in rows.tolist()], np.int32)
        objects = boxes3d([[row, 0, 0, 1, 1, 1, 0] for row in range(len(numbers))], scores=[0.5] * len(numbers))
        fused = Fused(objects, counts, rows, tracks=tracks_of(numbers))
        said = {name: np.array(rows, np.int64) for name, rows in words.items()}
        found.append(confirmations.confirm(fused, round(at_s * 1e9), said).matched.tolist())
    return found


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ([(0.0, {})], [0, 0, 0]),
        ([(0.0, {"a": [0], "b": [0, 1]})], [2, 1, 0]),
        ([(0.0, {"a": [0], "b": [0, 1]}), (0.1, {})], [2, 1, 0]),  # no image takes nothing back
        ([(0.0, {"a": [0], "b": [0, 1]}), (0.1, {"b": []})], [1, 0, 0]),  # an image does
        ([(0.0, {"a": [0]}), (0.1, {"b": [0]})], [2, 0, 0]),
        ([(0.0, {"a": [0]}), (1.0, {})], [1, 0, 0]),
        ([(0.0, {"a": [0]}), (1.1, {})], [0, 0, 0]),  # too long ago
        ([(5.0, {"a": [0]}), (4.9, {})], [0, 0, 0]),  # time jumped back
    ],
)
def test_the_last_word_of_a_camera_holds(frames: list[tuple[float, Words]], expected: list[int]) -> None:
    assert matched(*frames)[-1] == expected


def test_without_objects_and_without_tracks() -> None:
    assert matched((0.0, {"a": []}), numbers=()) == [[]]
    untracked = Fused(boxes3d([], scores=[]), np.zeros(0, np.int32), np.zeros(0, np.int64))
    assert Confirmations().confirm(untracked, 0, {}) is untracked
