from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d

from pipeline.core.detections import Boxes3D
from pipeline.core.frame import SensorBundle
from pipeline.core.rig import RecordedDetector, Rig
from pipeline.stages.detect3d import Recorded3D

RIG = Rig(
    "site", (), (), (), detectors=tuple(RecordedDetector(name, f"/{name}", "site", {}) for name in ("a", "b", "c"))
)
FRAME = SensorBundle(0, 1, 1, {})


def at(*places: float, scores: list[float] | None = None) -> Boxes3D:
    return boxes3d([(x, 0, 0.8, 4, 2, 1.5, 0.0) for x in places], scores=scores)


def test_better_ones_first_whatever_the_detector() -> None:
    joined = Recorded3D(RIG)(FRAME, {"b": at(20, 50, scores=[0.3, 0.9]), "a": at(10, 0, scores=[0.3, 0.6])})
    assert joined.centers[:, 0].tolist() == [50, 0, 10, 20]
    np.testing.assert_array_equal(joined.scores, np.array([0.9, 0.6, 0.3, 0.3], np.float32))


def test_of_two_detectors_that_see_one_object_the_better_is_kept() -> None:
    found = {"a": at(0, 30, scores=[0.5, 0.6]), "b": at(0.5, scores=[0.7]), "c": at(30.2, scores=[0.6])}
    assert Recorded3D(RIG)(FRAME, found).centers[:, 0].tolist() == [0.5, 30]


def test_what_one_detector_says_next_to_itself_is_left() -> None:
    assert len(Recorded3D(RIG)(FRAME, {"a": at(0, 0.5, 0.6)})) == 3


@pytest.mark.parametrize("found", [{}, {"a": at()}, {"a": at(), "c": at()}])
def test_no_boxes(found: dict[str, Boxes3D]) -> None:
    joined = Recorded3D(RIG)(FRAME, found)
    assert (len(joined), joined.stamp_ns, joined.frame_id) == (0, 1, "site")


def test_the_order_of_the_messages_does_not_matter() -> None:
    a, b = at(0, 10, 20, scores=[0.5, 0.5, 0.5]), at(0, 10, 40, scores=[0.5, 0.5, 0.5])
    one, other = Recorded3D(RIG)(FRAME, {"a": a, "b": b}), Recorded3D(RIG)(FRAME, {"b": b, "a": a})
    for name in ("centers", "scores", "point_counts"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.centers[:, 0].tolist() == [0, 10, 20, 40]


def test_boxes_of_another_time_are_refused() -> None:
    with pytest.raises(ValueError, match="expected boxes at 1 ns"):
        Recorded3D(RIG)(FRAME, {"a": replace(at(1), stamp_ns=7)})
