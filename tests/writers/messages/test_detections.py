from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import boxes2d, boxes3d
from frames import CONFIG, RIG, START_NS, through_cdr, tracks_of
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.messages.detections import decode_detections3d, track_ids
from lidcam.writers.messages.detections import detections_2d, detections_3d, lidcam_objects, track_array

NAMES = CONFIG.class_names


metres = st.floats(-1e4, 1e4)
lengths = st.floats(0.01, 50)
yaws = st.floats(-np.pi, np.pi, exclude_min=True)
variances = st.floats(0, 10)


@st.composite
def many_boxes(draw: st.DrawFn) -> Boxes3D:
    n = draw(st.integers(0, 4))
    rows = draw(st.lists(st.tuples(metres, metres, metres, lengths, lengths, lengths, yaws), min_size=n, max_size=n))
    upper = np.array(draw(st.lists(st.lists(variances, min_size=6, max_size=6), min_size=n, max_size=n)))
    covariances = upper.reshape(n, 6)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    found = boxes3d(
        rows,
        scores=draw(st.lists(st.floats(0, 1, width=32), min_size=n, max_size=n)),
        class_ids=draw(st.lists(st.integers(0, len(NAMES) - 1), min_size=n, max_size=n)),
    )
    return replace(found, stamp_ns=START_NS, frame_id="site", covariances=covariances)


@given(many_boxes())
def test_boxes_come_back_from_a_detection_array(boxes: Boxes3D) -> None:
    """By the definitions of vision_msgs and geometry_msgs."""
    message = through_cdr(detections_3d(boxes, NAMES, stamp_ns=START_NS))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(START_NS, 10**9)
    assert (message.header.frame_id, len(message.detections)) == ("site", len(boxes))
    for row, found in enumerate(message.detections):
        (result,), pose, size = found.results, found.bbox.center, found.bbox.size
        place, q = pose.position, pose.orientation
        assert [place.x, place.y, place.z] == boxes.centers[row].tolist()
        assert [size.x, size.y, size.z] == boxes.sizes[row].tolist()
        yaw = np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
        np.testing.assert_allclose(np.exp(1j * yaw), np.exp(1j * boxes.yaws[row]), atol=1e-12)
        hypothesis = result.hypothesis
        assert (hypothesis.class_id, hypothesis.score) == (NAMES[boxes.class_ids[row]], boxes.scores[row])
        np.testing.assert_array_equal(of_x_y_yaw(result.pose.covariance), boxes.covariances[row])
        assert (found.id, result.pose.pose) == ("", pose)


def of_x_y_yaw(covariance: Any) -> Any:
    return covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]


def test_the_number_of_a_track_is_the_id_that_is_read_back() -> None:
    message = detections_3d(
        boxes3d([[0, 0, 0, 1, 1, 1, 0]] * 4), NAMES, stamp_ns=START_NS, track_numbers=np.array([12, 0, 1, 10**17])
    )
    kind = message.__msgtype__
    channel = Channel("/fused/detections", kind, "cdr", ROS2.definition(kind), "ros2msg")
    raw = RawMessage(START_NS, START_NS, (0, 0), ROS2.serialize(message), channel)
    assert track_ids(decode_detections3d(raw).ids).tolist() == [12, UNKNOWN, 1, 10**17]


def test_tracks_say_how_objects_move_and_what_they_are() -> None:
    boxes = replace(
        boxes3d(np.array([[1, 2, 3, 4, 2, 1.5, 0.25], [0, 0, 0, 1, 1, 1, 0], [5, 6, 7, 8, 2.5, 3, -1]])), stamp_ns=1
    )
    boxes = replace(boxes, sources=np.array([Source.BOTH, Source.LIDAR, Source.PREDICTED], np.uint8))
    tracks = tracks_of([12, 0, 7], [[3.0, 4.0], [0.0, 0.0], [-1.0, 0.5]], [True, False, False])
    message = through_cdr(track_array(boxes, tracks, NAMES, stamp_ns=START_NS))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(START_NS, 10**9)
    assert message.header.frame_id == "site"
    assert [(one.id, one.class_id, one.source, one.front_known) for one in message.tracks] == [
        (12, NAMES[0], "both", True),
        (7, NAMES[0], "predicted", False),
    ]
    for row, one in zip((0, 2), message.tracks, strict=True):
        place, turn, moves = one.pose.pose.position, one.pose.pose.orientation, one.twist.twist
        assert [place.x, place.y, place.z] == boxes.centers[row].tolist()
        assert 2 * np.arctan2(turn.z, turn.w) == pytest.approx(boxes.yaws[row])
        assert [one.size.x, one.size.y, one.size.z] == boxes.sizes[row].tolist()
        assert [moves.linear.x, moves.linear.y] == tracks.velocities[row].tolist()
        assert (moves.angular.z, one.existence, one.age.sec, one.age.nanosec) == (0.5, 0.75, 1, 250_000_000)
        expected = [[0.25, 0.125, 0], [0.125, 0.5, 0], [0, 0, 0.0625]]
        np.testing.assert_array_equal(of_x_y_yaw(one.twist.covariance), expected)
        assert np.count_nonzero(one.twist.covariance) == 5
        np.testing.assert_array_equal(of_x_y_yaw(one.pose.covariance), boxes.covariances[row])


@pytest.mark.parametrize("rows", [[], [[1, 2, 4, 10, 0.5, 0]], [[1, 2, 4, 10, 0.5, 0], [0, 0, 640, 480, 1, 4]]])
def test_boxes_2d(rows: list[list[float]]) -> None:
    message = through_cdr(detections_2d(boxes2d(rows), NAMES, stamp_ns=START_NS, frame_id="cam"))
    assert message.header.frame_id == "cam"
    assert len(message.detections) == len(rows)
    for found, (left, top, right, bottom, score, class_id) in zip(message.detections, rows, strict=True):
        center = found.bbox.center
        assert (center.position.x, center.position.y, center.theta) == ((left + right) / 2, (top + bottom) / 2, 0)
        assert (found.bbox.size_x, found.bbox.size_y) == (right - left, bottom - top)
        hypothesis = found.results[0].hypothesis
        assert (hypothesis.class_id, hypothesis.score) == (NAMES[int(class_id)], score)
        assert found.header == message.header


CAR_PARK = Zone("car park", np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]]))


@pytest.mark.parametrize(
    ("zones", "xy", "intersection", "circle"),
    [
        *((RIG.zones, [(1.5, y)], [(1.5, y)], []) for y in (3.0, 0.0, -0.0)),
        *((RIG.zones, [(1.5, y)], [], [(1.5, y)]) for y in (-1e-9, -50.0)),
        (RIG.zones, [(1.5, 51.0)], [], []),
        ((), [(9, 0), (5, -500)], [(9, 0)], [(5, -500)]),  # the halves of the predecessor system
        ((CAR_PARK, *RIG.zones), [(1, 1), (9, 1)], [(9, 1)], []),  # others have no field
    ],
)
def test_zones(zones: tuple[Zone, ...], xy: Any, intersection: Any, circle: Any) -> None:
    boxes = boxes3d([[x, y, 7, 4, 2, 1, 0.25] for x, y in xy])
    message = through_cdr(lidcam_objects(boxes, zones, stamp_ns=START_NS))
    found = message.objects_intersection, message.objects_circle
    assert [[(one.pos_x, one.pos_y, one.alpha) for one in objects] for objects in found] == [
        [(x, y, 0.25) for x, y in expected] for expected in (intersection, circle)
    ]
    assert (message.num_intersection, message.num_circle) == (len(intersection), len(circle))
