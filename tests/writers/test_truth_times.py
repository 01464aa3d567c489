"""Truth and the frame it is drawn with."""

import numpy as np
import pytest

import lidcam.writers.truth_times as tested
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.truth_times import TruthTimes

SECOND = 1_000_000_000
NOTHING = np.zeros((0, 3))


def truth(stamp_s: float, log_s: float) -> TrueBoxes:
    times = round(stamp_s * SECOND), round(log_s * SECOND)
    return TrueBoxes("/gt", *times, "site", NOTHING, NOTHING, np.zeros(0), ())


def bundle(index: int, found: tuple[TrueBoxes, ...] = ()) -> SensorBundle:
    """Frames at 10 Hz, recorded 0.1 s late."""
    at_ns = 100 * SECOND + index * SECOND // 10
    return SensorBundle(index, at_ns, at_ns + SECOND // 10, {}, truth=found)


def frames_of(*bundles: SensorBundle) -> list[tuple[float, int]]:
    """The stamp of each truth, in seconds, and its frame, in the order in which they are told."""
    times = TruthTimes()
    known = [pair for one in bundles for pair in times.add_frame(one)] + times.rest()
    return [(round(boxes.stamp_ns / SECOND, 3), frame.index) for frame, boxes in known]


CASES = {
    "nothing": ([], []),
    "as recorded": ([(0, [(100.0, 100.1)]), (1, [(100.1, 100.2)])], [(100.0, 0), (100.1, 1)]),
    "recorded two frames late": (
        [(0, []), (1, []), (2, [(100.0, 100.25)]), (3, [(100.1, 100.35)])],
        [(100.0, 0), (100.1, 1)],
    ),
    "before its frame": ([(0, [(100.08, 100.09)]), (1, [])], [(100.08, 1)]),
    "between two": ([(0, [(100.04, 100.1), (100.06, 100.1)]), (1, [])], [(100.04, 0), (100.06, 1)]),
    "after the last": ([(0, [(100.04, 100.1)])], [(100.04, 0)]),
    "ended": ([(0, [(100.0, 100.1)]), (15, []), (16, []), (17, [])], [(100.0, 0), (101.6, 16)]),
    "after a gap": ([(0, [(100.0, 100.1)]), (16, []), (30, [(103.0, 103.1)])], [(100.0, 0), (101.6, 16), (103.0, 30)]),
    "of another clock": ([(0, [(7.0, 100.1)]), (1, [(7.1, 100.2)])], [(7.0, 0), (7.1, 1)]),
}


@pytest.mark.parametrize("case", CASES)
def test_truth_goes_with_the_nearest_frame(case: str) -> None:
    given, expected = CASES[case]
    bundles = [bundle(index, tuple(truth(*times) for times in found)) for index, found in given]
    assert frames_of(*bundles) == expected


def test_no_more_wait_than_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tested, "MAX_WAITING", 2)
    times = TruthTimes()
    early = tuple(truth(100.5 + at / 10, 100.0) for at in range(5))
    assert [boxes for _, boxes in times.add_frame(bundle(0, early))] == [*early[:3]]
    assert [boxes for _, boxes in times.rest()] == [*early[3:]]
