import numpy as np
from detections import boxes2d

from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.fusion.found import FoundBoxes

ONE = [(0.0, 0.0, 5.0, 5.0, 0.5, 0), (1.0, 0.0, 5.0, 5.0, 0.9, 1), (0.0, 0.0, 4.0, 5.0, 0.5, 0)]
TWO = [(7.0, 0.0, 9.0, 5.0, 0.3, 2)]


def test_ranked_camera_by_camera() -> None:
    found = FoundBoxes.of({"c": boxes2d(TWO), "a": boxes2d(ONE)}, ("a", "b", "c"))
    assert found.cameras.tolist() == [0, 0, 0, 2]
    assert found.rows.tolist() == [1, 2, 0, 0]
    np.testing.assert_array_equal(found.xyxy, np.array([*(ONE[k][:4] for k in (1, 2, 0)), TWO[0][:4]], np.float32))
    assert found.class_ids.tolist() == [1, 0, 0, 2]


def test_stamps_are_those_of_the_images() -> None:
    table = {
        "a": boxes2d(ONE),
        "b": Boxes2D(70, "b", *(getattr(boxes2d(TWO), f) for f in ("xyxy", "scores", "class_ids"))),
    }
    assert FoundBoxes.of(table, ("a", "b")).stamps_ns.tolist() == [*[table["a"].stamp_ns] * 3, 70]


def test_made_once_for_the_stages_of_a_frame() -> None:
    table = {"a": boxes2d(ONE), "b": boxes2d(TWO)}
    found = FoundBoxes.of(table, ("a", "b"))
    assert FoundBoxes.of({**table}, ["a", "b"]) is found
    assert FoundBoxes.of({"a": table["a"]}, ("a", "b")).cameras.tolist() == [0, 0, 0]
