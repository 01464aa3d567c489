from dataclasses import replace

import numpy as np
from detections import boxes2d, boxes3d, forward_camera
from lidar_scene import combined
from pipeline.fusion.belief.looks import looks_at

from pipeline.core.detections import Boxes3D, Hypotheses, Matches
from pipeline.core.geometry.boxes import box_corners

VIEW = forward_camera()
CAR = (20.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0)
ASIDE = (20.0, 5.0, 0.0, 4.0, 1.8, 1.5, 0.0)
BEHIND = (-20.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0)
AT_THE_BORDER = (5.0, 3.0, 0.0, 4.0, 1.8, 1.5, 0.0)
NO_POINTS = combined(np.zeros((0, 3)))


def hypotheses(boxes: Boxes3D, *pairs: tuple[int, int], hidden: float = 0.0) -> Hypotheses:
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    found = Matches(
        np.array(pairs, np.int64).reshape(-1, 2),
        np.full(len(pairs), 0.8, np.float32),
        VIEW.project_boxes(corners, "site"),
        np.full(len(boxes), hidden, np.float32),
    )
    return Hypotheses(boxes, {"cam": found}, len(boxes))


def test_what_a_camera_has_in_view() -> None:
    found = hypotheses(boxes3d([CAR, BEHIND, AT_THE_BORDER]))
    looks = looks_at(found, {"cam": boxes2d([])}, {"cam": VIEW}, NO_POINTS)
    assert looks.cameras == ("cam",)
    assert looks.in_view.tolist() == [[True, False, True]]
    assert looks.is_cut.tolist() == [[False, False, True]]
    assert looks.visible.tolist() == [[1.0, 0.0, 1.0]]
    left, top, right, bottom = found.matches["cam"].projected_xyxy[0]
    np.testing.assert_allclose(looks.size_px[0, 0] ** 2, (right - left) * (bottom - top), rtol=1e-5)
    assert looks.size_px[0, 1] == 0
    assert not looks.is_matched.any()


def test_a_match_with_its_score_and_its_overlap() -> None:
    found = hypotheses(boxes3d([CAR, CAR, ASIDE]), (1, 0))
    rectangle = found.matches["cam"].projected_xyxy[0]
    looks = looks_at(found, {"cam": boxes2d([(*rectangle, 0.75, 0)])}, {"cam": VIEW}, NO_POINTS)
    assert looks.is_matched.tolist() == [[False, True, False]]
    assert looks.scores.tolist() == [[0.0, 0.75, 0.0]]
    np.testing.assert_allclose(looks.iou, [[0.0, 0.8, 0.0]], rtol=1e-6)


def test_points_and_objects_in_front_hide() -> None:
    y, z = np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-1, 1, 40))
    wall = combined(np.stack([np.full(y.size, 8.0), y.ravel(), z.ravel()], 1))
    boxes, seen = boxes3d([CAR, ASIDE]), {"cam": boxes2d([])}
    behind_points = looks_at(hypotheses(boxes), seen, {"cam": VIEW}, wall).visible
    assert behind_points[0, 0] < 0.2
    assert behind_points[0, 1] == 1
    behind_objects = looks_at(hypotheses(boxes, hidden=0.75), seen, {"cam": VIEW}, NO_POINTS).visible
    assert behind_objects.tolist() == [[0.25, 0.25]]


def test_a_camera_without_an_entry_does_not_look() -> None:
    found = hypotheses(boxes3d([CAR]))
    both = replace(found, matches={"cam": found.matches["cam"], "other": found.matches["cam"]})
    assert looks_at(both, {"other": boxes2d([])}, {"cam": VIEW, "other": VIEW}, NO_POINTS).cameras == ("other",)
    assert looks_at(both, {}, {"cam": VIEW, "other": VIEW}, NO_POINTS).in_view.shape == (0, 1)


def test_no_hypotheses() -> None:
    looks = looks_at(hypotheses(boxes3d([])), {"cam": boxes2d([(0, 0, 9, 9, 0.5, 0)])}, {"cam": VIEW}, NO_POINTS)
    assert looks.in_view.shape == (1, 0)
