from dataclasses import replace

import numpy as np
from detections import boxes2d
from seen_boxes import camera_at, seen_by, views_of

from pipeline.core.detections import Boxes2D
from pipeline.fusion.cameras.sightings import see

CAR = (12.0, 1.0, 0.75, 4.2, 1.75, 1.5, 0.3)
CAMERA = camera_at("cam", (0.0, 0.0, 1.6))


def test_rays_point_to_the_outline_of_each_box_from_the_camera() -> None:
    camera = camera_at("tilted", (1.0, 2.0, 5.0), yaw_deg=20, pitch_deg=25, distortion=[-0.1, 0.05, 0.001, 0.002])
    found = see(views_of(camera), {"tilted": boxes2d([(300, 200, 500, 420, 0.9, 0)])})
    np.testing.assert_allclose(found.origin, [[1.0, 2.0, 5.0]], atol=1e-9)
    pixels, _ = camera.model.project(camera.T_camera_site.apply(found.origin[:, None] + 10 * found.rays))
    expected = [[300, 200], [400, 200], [500, 200], [500, 310], [500, 420], [400, 420], [300, 420], [300, 310]]
    np.testing.assert_allclose(pixels[0], expected, atol=1e-5)


def test_order_is_that_of_cameras_and_scores_and_not_that_of_the_boxes() -> None:
    rows = [(10, 10, 50, 90, 0.5, 1), (200, 10, 260, 90, 0.9, 0), (10, 10, 50, 90, 0.5, 0)]
    views = views_of(camera_at("b", (0.0, 0.0, 1.6)), camera_at("a", (0.0, 0.0, 1.6)), CAMERA)
    for order in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        found = see(views, {"a": boxes2d([rows[row] for row in order]), "b": boxes2d(rows[:1])})
        assert found.cameras.tolist() == [0, 1, 1, 1]
        assert found.scores.tolist() == np.array([0.5, 0.9, 0.5, 0.5], np.float32).tolist()
        assert found.class_ids.tolist() == [1, 0, 0, 1]
        assert [order[row] for row in found.rows[1:]] == [1, 2, 0]


def test_edges_at_the_border_are_cut_there() -> None:
    rows = [(-20, 100, 60, 800, 0.9, 0), (1200, 1.5, 1279, 90, 0.8, 0), (100, 100, 200, 200, 0.7, 0)]
    found = see(views_of(CAMERA), {"cam": boxes2d(rows)})
    assert found.cut.tolist() == [[True, False, False, True], [False, True, True, False], [False] * 4]
    assert found.xyxy[0].tolist() == [0, 100, 60, 720]


def test_boxes_that_show_nothing_are_left_out() -> None:
    rows = [(-50, 10, -5, 90, 0.9, 0), (50, 10, 50, 90, 0.8, 0), (np.nan, 10, 50, 90, 0.7, 0), (5, 5, 9, 9, 0.6, 0)]
    found = see(views_of(CAMERA), {"cam": boxes2d(rows)})
    assert found.rows.tolist() == [3]


def test_cameras_without_boxes_and_no_cameras() -> None:
    for views, boxes in (({}, {}), (views_of(CAMERA), {}), (views_of(CAMERA), {"cam": Boxes2D.empty(1, "cam")})):
        found = see(views, boxes)
        assert len(found) == 0
        assert found.rays.shape == (0, 8, 3)


def test_rows_can_be_selected() -> None:
    boxes = seen_by(CAMERA, [CAR, CAR], [0, 0])
    found = see(views_of(CAMERA), {"cam": replace(boxes, scores=np.array([0.5, 0.7], np.float32))})
    assert found.select(np.array([1])).scores.tolist() == [0.5]
    assert len(found.select(np.array([1])).views.image_sizes) == 1
