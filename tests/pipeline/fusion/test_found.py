import numpy as np
from detections import boxes2d

from lidcam.pipeline.fusion.found import FoundBoxes

ONE = [(0.0, 0.0, 5.0, 5.0, 0.5, 0), (1.0, 0.0, 5.0, 5.0, 0.9, 1), (0.0, 0.0, 4.0, 5.0, 0.5, 0)]
TWO = [(7.0, 0.0, 9.0, 5.0, 0.3, 2)]


def test_ranked_camera_by_camera() -> None:
    found = FoundBoxes.of({"c": boxes2d(TWO), "a": boxes2d(ONE)}, ("a", "b", "c"))
    assert found.cameras.tolist() == [0, 0, 0, 2]
    assert found.rows.tolist() == [1, 2, 0, 0]
    np.testing.assert_array_equal(found.xyxy, np.array([*(ONE[k][:4] for k in (1, 2, 0)), TWO[0][:4]], np.float32))
    assert found.class_ids.tolist() == [1, 0, 0, 2]
