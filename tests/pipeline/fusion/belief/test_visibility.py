from dataclasses import replace

import numpy as np
import pytest
from detections import boxes2d, boxes3d, forward_camera
from lidar_scene import combined

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.association import class_agreement
from lidcam.pipeline.core.detections import Boxes3D, Hypotheses, Matches
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.fusion.belief.visibility import find_visibility, hidden_by_points

VIEW = forward_camera()  # 640 x 480 px, f = 500 px, seen along x
CAR = (20.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0)
ASIDE = (20.0, 5.0, 0.0, 4.0, 1.8, 1.5, 0.0)
BEHIND = (-20.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0)
AT_THE_BORDER = (5.0, 3.0, 0.0, 4.0, 1.8, 1.5, 0.0)
NO_POINTS = combined(np.zeros((0, 3)))
AGREEMENT = class_agreement(ROAD_CLASSES)


def hypotheses(boxes: Boxes3D, *pairs: tuple[int, int], hidden: float = 0.0) -> Hypotheses:
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    found = Matches(
        np.array(pairs, np.int64).reshape(-1, 2),
        np.full(len(pairs), 0.8, np.float32),
        VIEW.model.project_boxes(VIEW.T_camera_site.apply(corners)),
        np.full(len(boxes), hidden, np.float32),
        np.zeros((len(boxes), 4), np.float32),
    )
    return Hypotheses(boxes, {"cam": found}, len(boxes))


def test_what_a_camera_has_in_view() -> None:
    found = hypotheses(boxes3d([CAR, BEHIND, AT_THE_BORDER]))
    seen = find_visibility(found, {"cam": boxes2d([])}, {"cam": VIEW}, NO_POINTS, AGREEMENT)
    assert seen.cameras == ("cam",)
    assert seen.in_view.tolist() == [[True, False, True]]
    assert seen.is_cut.tolist() == [[False, False, True]]
    assert seen.visible.tolist() == [[1.0, 0.0, 1.0]]
    left, top, right, bottom = found.matches["cam"].projected_xyxy[0]
    np.testing.assert_allclose(seen.size_px[0, 0] ** 2, (right - left) * (bottom - top), rtol=1e-5)
    assert seen.size_px[0, 1] == 0
    assert not seen.is_matched.any()


def test_a_match_with_its_score_and_its_overlap() -> None:
    found = hypotheses(boxes3d([CAR, CAR, ASIDE]), (1, 0))
    rectangle = found.matches["cam"].projected_xyxy[0]
    seen = find_visibility(found, {"cam": boxes2d([(*rectangle, 0.75, 0)])}, {"cam": VIEW}, NO_POINTS, AGREEMENT)
    assert seen.is_matched.tolist() == [[False, True, False]]
    assert seen.scores.tolist() == [[0.0, 0.75, 0.0]]
    np.testing.assert_allclose(seen.iou, [[0.0, 0.8, 0.0]], rtol=1e-6)


def test_a_detector_without_a_name_for_a_class_does_not_look_for_it() -> None:
    found = hypotheses(boxes3d([CAR, CAR, ASIDE], class_ids=[0, 1, 1]), (1, 0))
    seen = find_visibility(found, {"cam": boxes2d([(0, 0, 9, 9, 0.7, 0)])}, {"cam": VIEW}, NO_POINTS, AGREEMENT, {1})
    assert seen.in_view.tolist() == [[True, True, False]]
    assert seen.size_px[0, 2] == 0


def test_points_and_objects_in_front_hide() -> None:
    points = combined(wall(8.0, (-1, 1), (-1, 1)).astype(np.float64))
    boxes, empty = boxes3d([CAR, ASIDE]), {"cam": boxes2d([])}
    behind_points = find_visibility(hypotheses(boxes), empty, {"cam": VIEW}, points, AGREEMENT).visible
    assert behind_points[0, 0] < 0.2
    assert behind_points[0, 1] == 1
    behind_objects = find_visibility(hypotheses(boxes, hidden=0.75), empty, {"cam": VIEW}, NO_POINTS, AGREEMENT).visible
    assert behind_objects.tolist() == [[0.25, 0.25]]


def test_a_camera_without_an_entry_does_not_look() -> None:
    found = hypotheses(boxes3d([CAR]))
    both = replace(found, matches={"cam": found.matches["cam"], "other": found.matches["cam"]})
    assert find_visibility(
        both, {"other": boxes2d([])}, {"cam": VIEW, "other": VIEW}, NO_POINTS, AGREEMENT
    ).cameras == ("other",)
    assert find_visibility(both, {}, {"cam": VIEW, "other": VIEW}, NO_POINTS, AGREEMENT).in_view.shape == (0, 1)


def test_no_hypotheses() -> None:
    seen = find_visibility(
        hypotheses(boxes3d([])), {"cam": boxes2d([(0, 0, 9, 9, 0.5, 0)])}, {"cam": VIEW}, NO_POINTS, AGREEMENT
    )
    assert seen.in_view.shape == (1, 0)


PLATE = (10.0, 0.0, 0.0, 0.1, 4.0, 4.0, 0.0)


def wall(x_m: float, y_m: tuple[float, float] = (-2.0, 2.0), z_m: tuple[float, float] = (-2.0, 2.0)) -> F32:
    y, z = np.meshgrid(np.linspace(*y_m, 60), np.linspace(*z_m, 60))
    return np.stack([np.full(y.size, x_m), y.ravel(), z.ravel()], 1).astype(np.float32)


def hidden(points: F32, *rows: tuple[float, ...], views: tuple[CameraSensor, ...] = (VIEW,)) -> F64:
    boxes = boxes3d(rows)
    cameras, objects = np.nonzero(np.ones((len(views), len(rows))))
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    return hidden_by_points(views, points, corners, cameras, objects)


HALF = wall(5.0, (0.0, 1.0), (-1.0, 1.0))


@pytest.mark.parametrize(
    ("points", "low", "high"),
    [
        pytest.param(np.zeros((0, 3), np.float32), 0.0, 0.0, id="nothing"),
        pytest.param(wall(5.0), 0.95, 1.0, id="in front"),
        pytest.param(wall(15.0), 0.0, 0.0, id="behind"),
        pytest.param(wall(9.9), 0.0, 0.0, id="on it"),
        pytest.param(-wall(5.0), 0.0, 0.0, id="behind the camera"),
        pytest.param(wall(5.0, (-10.0, -3.0)), 0.0, 0.0, id="beside"),
        pytest.param(np.concatenate([HALF, wall(10.0)]), 0.4, 0.65, id="half"),
        pytest.param(np.array([[5.0, 0, 0]], np.float32), 0.5, 0.5, id="one point does not hide all"),
    ],
)
def test_what_is_nearer_hides(points: F32, low: float, high: float) -> None:
    (share,) = hidden(points, PLATE)
    assert low <= share <= high


def test_objects_beside_and_behind_the_camera_are_hidden_by_nothing_but_do_no_harm() -> None:
    shares = hidden(wall(5.0), (-10.0, 0, 0, 4, 2, 2, 0), (0.0, 20, 0, 4, 2, 2, 0), (0.0, 0, 0, 4, 2, 2, 0))
    assert np.isfinite(shares).all()
    assert (shares[1:] == 0).all()


def test_many_points_are_looked_at_evenly() -> None:
    dense = np.repeat(wall(5.0), 20, axis=0)
    assert hidden(dense, PLATE)[0] == pytest.approx(hidden(wall(5.0), PLATE)[0], abs=0.05)
