from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d, forward_camera
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import F32
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.matching.in_view import InView, hidden_parts, project_into_views
from lidcam.pipeline.fusion.projection import CameraArrays

RIGHT = np.array([[-1.0, 0, 0, 0], [0, 0, -1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
LENS = forward_camera("lens", distortion=[-0.2, 0.05, 0.001, -0.002, 0.01])
FISHEYE = replace(
    forward_camera("fisheye"),
    model=replace(forward_camera("fisheye").model, model="equidistant", K=LENS.model.K.copy()),
)
ASIDE = replace(forward_camera("right"), T_camera_site=Transform("right", "site", RIGHT))
CAMERAS = (forward_camera(), LENS, FISHEYE, ASIDE)


def project(boxes: Boxes3D, cameras: tuple[CameraSensor, ...] = CAMERAS) -> InView:
    return project_into_views(boxes, cameras, CameraArrays.of(cameras))


def test_ranges_and_derivatives() -> None:
    boxes = boxes3d([(10, 2, 0, 4, 2, 1.5, 0.3), (3, -4, 0, 4, 2, 1.5, 0.3)])
    seen = project(boxes, (forward_camera(),))
    assert seen.ranges_m.tolist() == pytest.approx([np.hypot(10, 2), 5])
    step = 1e-5
    for parameter in range(3):
        centers, yaws = boxes.centers.copy(), boxes.yaws.copy()
        if parameter < 2:
            centers[:, parameter] += step
        else:
            yaws += step
        camera = forward_camera()
        moved = camera.model.project(camera.T_camera_site.apply(box_corners(centers, boxes.sizes, yaws)))[0]
        still = camera.model.project(camera.T_camera_site.apply(box_corners(boxes.centers, boxes.sizes, boxes.yaws)))[0]
        low, high = moved.min(1) - still.min(1), moved.max(1) - still.max(1)
        slope = np.concatenate([low, high], 1) / step
        assert seen.jacobian[0, :, parameter] == pytest.approx(slope[0], abs=0.05)
        assert seen.jacobian[1, 0, parameter] == pytest.approx(slope[1, 0], abs=0.5)
    assert seen.xyxy[1, 2] == 640
    assert not seen.jacobian[1, 2].any(), "the border of the image does not move"


def test_a_box_beside_the_camera_is_cut_and_has_no_derivatives() -> None:
    seen = project(boxes3d([(0, 1.5, 0, 10, 1, 1.5, 0.0)]), (forward_camera(),))
    assert len(seen) == 1
    assert not seen.jacobian.any()


def test_nothing() -> None:
    assert len(project(boxes3d([]))) == 0
    assert len(project(boxes3d([(10, 0, 0, 4, 2, 1.5, 0)]), ())) == 0


def test_boxes_in_another_frame_are_refused() -> None:
    with pytest.raises(FrameError, match="camera cam: expected boxes in frame 'site', found 'odom'"):
        project(boxes3d([], frame_id="odom"))


ONE = (forward_camera(),)
CAR, PEDESTRIAN = (4.0, 1.8, 1.5), (0.6, 0.6, 1.7)


def hide(boxes: Boxes3D) -> tuple[InView, F32, F32, F32]:
    seen = project_into_views(boxes, ONE, CameraArrays.of(ONE))
    return seen, *hidden_parts(boxes, seen, np.zeros((1, 3)))


def test_a_car_behind_a_car() -> None:
    seen, hidden, rest, _ = hide(boxes3d([(20, 2.5, 0, *CAR, 0), (10, 0.0, 0, *CAR, 0)]))
    far, near = seen.xyxy
    left, right = max(far[0], near[0]), min(far[2], near[2])
    assert hidden[0] == pytest.approx((right - left) / (far[2] - far[0]), abs=1e-4)
    assert hidden[1] == 0
    np.testing.assert_allclose(rest[0], [far[0], far[1], near[0], far[3]], atol=1e-3)
    np.testing.assert_array_equal(rest[1], near)


@pytest.mark.parametrize(
    ("near", "edges"),
    [
        ((10, 0.0, 0, *CAR, 0), "right"),  # beside the far car's right half
        ((10, 2.6, 0, *CAR, 0), "left"),
        ((10, 1.25, 0.6, 4.0, 5.0, 0.5, 0), "top"),  # a beam over it
        ((10, 1.25, -0.7, 4.0, 5.0, 0.5, 0), "bottom"),
        ((10, 1.4, 0, 0.2, 0.2, 1.5, 0), "none"),  # a post before its middle leaves all of its edges
        ((10, 0.0, -0.9, *CAR, 0), "none"),  # covers less than half of its right edge
    ],
)
def test_the_edges_that_a_nearer_box_covers(near: tuple[float, ...], edges: str) -> None:
    seen, _, _, depths = hide(boxes3d([(20, 2.5, 0, *CAR, 0), near]))
    far, front = seen.xyxy
    covers = {
        "left": front[2] - far[0],
        "top": front[3] - far[1],
        "right": far[2] - front[0],
        "bottom": far[3] - front[1],
    }
    expected = [covers[edge] if edge == edges else 0.0 for edge in covers]
    np.testing.assert_allclose(depths, [expected, [0.0] * 4], atol=1e-3)


def test_what_is_wholly_hidden_keeps_its_rectangle() -> None:
    seen, hidden, rest, _ = hide(boxes3d([(20, 0, 0, *CAR, 0), (10, 0, 0, *CAR, 0)]))
    assert hidden.tolist() == [1, 0]
    np.testing.assert_array_equal(rest, seen.xyxy)


@pytest.mark.parametrize(
    ("bus", "pedestrian", "hidden"),
    [
        ((16, 0.0, 0.0), (15.0, 2.4), "neither"),  # the bus stands along the view, from 10 to 22 m; he walks beside it
        ((16, 0.0, 0.0), (15.0, 1.8), "pedestrian"),  # behind its near end, though its middle is farther than he is
        ((15, 3.5, 0.73), (14.0, 5.2), "bus"),  # in front of its side, though its near end is nearer than he is
        ((15, 3.5, 0.73), (13.5, -0.6), "pedestrian"),  # behind it, though its middle is farther
    ],
)
def test_which_is_in_front_of_a_long_box(
    bus: tuple[float, float, float], pedestrian: tuple[float, float], hidden: str
) -> None:
    x, y, yaw = bus
    _, found, _, _ = hide(boxes3d([(x, y, 0, 12, 2.5, 3.0, yaw), (*pedestrian, 0, *PEDESTRIAN, 0)]))
    assert [found[0] > 0, found[1] > 0] == [hidden == "bus", hidden == "pedestrian"]


places = st.tuples(st.floats(6, 25), st.floats(-4, 4), st.just(0.0))
sizes = st.tuples(st.sampled_from([1.0, 4.0]), st.floats(0.5, 2), st.floats(0.5, 2))
spots = st.tuples(places, sizes, st.floats(-3, 3)).map(lambda spot: (*spot[0], *spot[1], spot[2]))


@given(st.lists(spots, max_size=7))
def test_shares_are_those_of_painted_images(table: list[tuple[float, ...]]) -> None:
    apart = [row for k, row in enumerate(table) if all(np.hypot(row[0] - o[0], row[1] - o[1]) > 5 for o in table[:k])]
    boxes = boxes3d(apart)
    seen, hidden, rest, _ = hide(boxes)
    nearest_first = np.argsort(seen.ranges_m)
    painted = np.zeros((480, 640), np.bool_)
    for k in nearest_first:
        left, top, right, bottom = (round(float(v)) for v in seen.xyxy[k])
        place = painted[top:bottom, left:right]
        if place.size > 400:
            assert hidden[k] == pytest.approx(place.mean(), abs=0.12)
        place[:] = True
        assert (rest[k, :2] >= seen.xyxy[k, :2]).all()
        assert (rest[k, 2:] <= seen.xyxy[k, 2:]).all()


def test_more_covers_than_are_counted() -> None:
    crowd = [(8.0 + k, (k - 6) / 5, 0, *PEDESTRIAN, 0) for k in range(12)]
    _, hidden, _, _ = hide(boxes3d([(40, 0, 0, 4, 20, 3, 0), *crowd]))
    assert 0.1 < hidden[0] < 0.9
