import numpy as np
import pytest
from detections import boxes3d, forward_camera
from hypothesis import given
from hypothesis import strategies as st
from pipeline.fusion.matching.hiding import hidden_parts

from pipeline.core.arrays import F32
from pipeline.core.detections import Boxes3D
from pipeline.fusion.matching.in_view import InView, project_into_views
from pipeline.fusion.projection import CameraArrays

CAMERAS = (forward_camera(),)
CAR, PEDESTRIAN = (4.0, 1.8, 1.5), (0.6, 0.6, 1.7)


def hide(boxes: Boxes3D) -> tuple[InView, F32, F32]:
    seen = project_into_views(boxes, CAMERAS, CameraArrays.of(CAMERAS))
    return seen, *hidden_parts(boxes, seen, np.zeros((1, 3)))


def test_a_car_behind_a_car() -> None:
    seen, hidden, rest = hide(boxes3d([(20, 2.5, 0, *CAR, 0), (10, 0.0, 0, *CAR, 0)]))
    far, near = seen.xyxy
    left, right = max(far[0], near[0]), min(far[2], near[2])
    assert hidden[0] == pytest.approx((right - left) / (far[2] - far[0]), abs=1e-4)
    assert hidden[1] == 0
    np.testing.assert_allclose(rest[0], [far[0], far[1], near[0], far[3]], atol=1e-3)
    np.testing.assert_array_equal(rest[1], near)


def test_what_is_wholly_hidden_keeps_its_rectangle() -> None:
    seen, hidden, rest = hide(boxes3d([(20, 0, 0, *CAR, 0), (10, 0, 0, *CAR, 0)]))
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
    _, found, _ = hide(boxes3d([(x, y, 0, 12, 2.5, 3.0, yaw), (*pedestrian, 0, *PEDESTRIAN, 0)]))
    assert [found[0] > 0, found[1] > 0] == [hidden == "bus", hidden == "pedestrian"]


places = st.tuples(st.floats(6, 25), st.floats(-4, 4), st.just(0.0))
sizes = st.tuples(st.sampled_from([1.0, 4.0]), st.floats(0.5, 2), st.floats(0.5, 2))
spots = st.tuples(places, sizes, st.floats(-3, 3)).map(lambda spot: (*spot[0], *spot[1], spot[2]))


@given(st.lists(spots, max_size=7))
def test_shares_are_those_of_painted_pictures(table: list[tuple[float, ...]]) -> None:
    apart = [row for k, row in enumerate(table) if all(np.hypot(row[0] - o[0], row[1] - o[1]) > 5 for o in table[:k])]
    boxes = boxes3d(apart)
    seen, hidden, rest = hide(boxes)
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


def test_no_boxes() -> None:
    _, hidden, rest = hide(boxes3d([]))
    assert (hidden.shape, rest.shape) == ((0,), (0, 4))


def test_more_covers_than_are_counted() -> None:
    crowd = [(8.0 + k, (k - 6) / 5, 0, *PEDESTRIAN, 0) for k in range(12)]
    _, hidden, _ = hide(boxes3d([(40, 0, 0, 4, 20, 3, 0), *crowd]))
    assert 0.1 < hidden[0] < 0.9
