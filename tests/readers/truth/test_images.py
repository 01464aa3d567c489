from dataclasses import replace

import numpy as np
import pytest
from detections import forward_camera
from evaluation_frames import truth_boxes

from pipeline.core.rig import CameraSensor
from pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes3D
from readers.truth.moment import projected_truth

CAMERA: CameraSensor = forward_camera("left")


def boxes(*pixels: int) -> TruthBoxes3D:
    """Four objects: two ahead of the camera, one beside its image, one behind it."""
    places = [(10.0, 0), (20, 1), (5, 60), (-10, 0)]
    found = truth_boxes(
        [(x, y, 0, 2, 1, 1, 0) for x, y in places],
        [1, 2, 3, 4],
        class_ids=[0, 3, 0, 0],
        labels=["car", "van", "car", "car"],
        image_pixels=pixels or None,
        is_ignored=[False, True, False, False],
    )
    return replace(found, stamp_ns=7)


def test_objects_ahead_are_seen() -> None:
    shown = projected_truth(boxes(), CAMERA, None)
    assert shown.stamp_ns == 7
    assert shown.track_ids.tolist() == [1, 2]
    assert shown.labels.tolist() == ["car", "van"]
    assert shown.class_ids.tolist() == [0, 3]
    assert shown.image_pixels.tolist() == [UNKNOWN, UNKNOWN]
    assert shown.is_ignored.tolist() == [False, True]


def test_boxes_surround_the_projection() -> None:
    shown = projected_truth(boxes(), CAMERA, None)
    corners = np.array([[9.0, y, z] for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    pixels, _ = CAMERA.model.project(CAMERA.T_camera_site.apply(corners))
    np.testing.assert_allclose(shown.xyxy[0], [*pixels.min(0), *pixels.max(0)], atol=1e-3)
    assert projected_truth(boxes().select(np.zeros(4, np.bool_)), CAMERA, None).xyxy.shape == (0, 4)


@pytest.mark.parametrize(
    ("overall", "of_image", "ids", "pixels"),
    [
        ((5, 0, 5, 5), None, [1], [UNKNOWN]),
        ((UNKNOWN, 0, 5, 5), None, [1], [UNKNOWN]),
        ((5, 5, 5, 5), [0, 3, 3, 3], [2], [3]),
        ((5, 5, 5, 5), [4, UNKNOWN, 3, 3], [1, 2], [4, UNKNOWN]),
        ((5, 0, 5, 5), [4, UNKNOWN, 3, 3], [1], [4]),
    ],
)
def test_hidden_objects_are_left_out(
    overall: tuple[int, ...], of_image: list[int] | None, ids: list[int], pixels: list[int]
) -> None:
    counts = None if of_image is None else np.array(of_image, np.int32)
    shown = projected_truth(boxes(*overall), CAMERA, counts)
    assert shown.track_ids.tolist() == ids
    assert shown.image_pixels.tolist() == pixels
