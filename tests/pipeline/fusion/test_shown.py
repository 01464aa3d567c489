from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from detections import boxes2d, boxes3d, forward_camera

from lidcam.pipeline.fusion.matching.in_view import project_into_views
from lidcam.pipeline.fusion.projection import CameraArrays
from lidcam.pipeline.fusion.shown import NO_TRACK, Origin, ShownBoxes, shown_boxes

CAMERA = forward_camera()
CARS = [(20, 4, 0, 4.2, 1.8, 1.5, 0.3), (10, 0, 0, 4.2, 1.8, 1.5, 0.0), (16, 0, 0, 4.2, 1.8, 1.4, 0.0)]
"""One by itself; one ahead; one behind that one, which hides it."""


def shown(found: npt.ArrayLike, *, predicted: Sequence[int] = ()) -> ShownBoxes:
    objects = boxes3d(CARS, class_ids=[0, 1, 0])
    return shown_boxes(objects, np.arange(3) + 7, np.isin(np.arange(3), predicted), CAMERA, boxes2d(found))


def rectangles() -> npt.NDArray[np.float32]:
    """Around the whole boxes."""
    return project_into_views(boxes3d(CARS), [CAMERA], CameraArrays.of([CAMERA])).xyxy


def test_objects_are_drawn_unless_they_are_hidden_or_predicted() -> None:
    found = shown([])
    assert found.track_ids.tolist() == [7, 8]
    assert found.origins.tolist() == [Origin.OBJECT] * 2
    around = rectangles()[:2]
    assert (found.xyxy[:, :2] >= around[:, :2]).all(), "a car is round, and smaller than its box"
    assert (found.xyxy[:, 2:] <= around[:, 2:]).all()
    assert np.abs(found.xyxy - around).max() < 15
    assert shown([], predicted=[0]).track_ids.tolist() == [8]


def test_the_2d_box_of_an_object_stands_for_it_even_if_it_is_hidden() -> None:
    """With the class, the score and the track of the object; and within the image."""
    xyxy = rectangles()[2] + np.array([2, -1, -3, 1], np.float32)
    found = shown([(*xyxy, 0.9, 1)], predicted=[2])
    assert found.track_ids.tolist() == [7, 8, 9]
    assert found.origins.tolist() == [Origin.OBJECT, Origin.OBJECT, Origin.BOTH]
    np.testing.assert_allclose(found.xyxy[2], xyxy)
    assert (found.class_ids[2], found.scores[2]) == (0, 0.5)


@pytest.mark.parametrize(("box", "is_drawn"), [((-9, 10, 40, 60, 0.6, 1), True), ((-9, 10, 40, 60, 0.4, 1), False)])
def test_a_2d_box_without_an_object_needs_a_good_score(box: tuple[float, ...], is_drawn: bool) -> None:
    found = shown([box])
    assert len(found) == 2 + is_drawn
    if is_drawn:
        assert found.xyxy[2].tolist() == [0, 10, 40, 60]
        assert (found.class_ids[2], found.track_ids[2], found.origins[2]) == (1, NO_TRACK, Origin.CAMERA)


def test_a_second_2d_box_of_an_object_is_not_another_object() -> None:
    first, *_ = rectangles()
    found = shown([(*first, 0.9, 0), (*(first + 1), 0.8, 1)])
    assert len(found) == 2


def test_a_sliver_is_no_box() -> None:
    assert len(shown([(-30, 10, 1, 60, 0.9, 1)])) == 2
