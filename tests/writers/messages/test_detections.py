from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import boxes2d, boxes3d
from frames import CONFIG, RIG, START_NS, tracks_of
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.ros.typestores import message_types
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.messages.detections import decode_detections3d, track_ids
from lidcam.writers.messages.detections import detections_2d, detections_3d, lidcam_objects, track_array

NAMES = CONFIG.class_names


def through_cdr(message: Any) -> Any:
    """The message after a trip through its bytes."""
    return message_types(2).deserialize_cdr(ROS2.serialize(message), message.__msgtype__)


metres = st.floats(-1e4, 1e4)
lengths = st.floats(0.01, 50)
yaws = st.floats(-np.pi, np.pi, exclude_min=True)
variances = st.floats(0, 10)


@st.composite
def many_boxes(draw: st.DrawFn) -> Boxes3D:
    n = draw(st.integers(0, 4))
    rows = draw(st.lists(st.tuples(metres, metres, metres, lengths, lengths, lengths, yaws), min_size=n, max_size=n))
    upper = np.array(draw(st.lists(st.lists(variances, min_size=6, max_size=6), min_size=n, max_size=n)))
    covariances = np.zeros((n, 3, 3))
    if n:
        rows_3, columns_3 = np.triu_indices(3)
        covariances[:, rows_3, columns_3] = upper
        covariances[:, columns_3, rows_3] = upper
    found = boxes3d(
        rows,
        scores=draw(st.lists(st.floats(0, 1, width=32), min_size=n, max_size=n)),
        class_ids=draw(st.lists(st.integers(0, len(NAMES) - 1), min_size=n, max_size=n)),
    )
    return replace(found, stamp_ns=START_NS, frame_id="site", covariances=covariances)


def back(message: Any) -> Boxes3D:
    """What a user would make of a Detection3DArray, by the definitions of vision_msgs and geometry_msgs."""
    n = len(message.detections)
    poses = [d.bbox.center for d in message.detections]
    full = np.array([d.results[0].pose.covariance for d in message.detections]).reshape(n, 6, 6)
    yaws = [
        np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2)) for q in (pose.orientation for pose in poses)
    ]
    return Boxes3D(
        message.header.stamp.sec * 10**9 + message.header.stamp.nanosec,
        message.header.frame_id,
        np.array([[p.position.x, p.position.y, p.position.z] for p in poses]).reshape(n, 3),
        np.array([[d.bbox.size.x, d.bbox.size.y, d.bbox.size.z] for d in message.detections]).reshape(n, 3),
        np.where(np.array(yaws) <= -np.pi, np.pi, np.array(yaws)).reshape(n),
        np.array([d.results[0].hypothesis.score for d in message.detections], np.float32),
        np.array([NAMES.index(d.results[0].hypothesis.class_id) for d in message.detections], np.int32),
        np.zeros(n, np.int32),
        full[:, [[0], [1], [5]], [0, 1, 5]].reshape(n, 3, 3),
        np.zeros(n, np.uint8),
        np.zeros(n, np.int64),
    )


@given(many_boxes())
def test_boxes_come_back_from_a_detection_array(boxes: Boxes3D) -> None:
    message = through_cdr(detections_3d(boxes, NAMES, stamp_ns=START_NS))
    found = back(message)
    assert (found.stamp_ns, found.frame_id) == (START_NS, "site")
    for name in ("centers", "sizes", "scores", "class_ids", "covariances"):
        np.testing.assert_array_equal(getattr(found, name), getattr(boxes, name), err_msg=name)
    np.testing.assert_allclose(np.exp(1j * found.yaws), np.exp(1j * boxes.yaws), atol=1e-12)
    assert all(detection.id == "" for detection in message.detections)
    assert all(detection.results[0].pose.pose == detection.bbox.center for detection in message.detections)


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
        full = one.twist.covariance.reshape(6, 6)
        expected = [[0.25, 0.125, 0], [0.125, 0.5, 0], [0, 0, 0.0625]]
        np.testing.assert_array_equal(full[np.ix_([0, 1, 5], [0, 1, 5])], expected)
        assert np.count_nonzero(full) == 5
        np.testing.assert_array_equal(
            one.pose.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])], boxes.covariances[row]
        )


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


SQUARE = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]])


@pytest.mark.parametrize(
    ("y", "zone"),
    [*((y, "intersection") for y in (3.0, 0.0, -0.0)), *((y, "circle") for y in (-1e-9, -50.0)), (51.0, "")],
)
def test_zones(y: float, zone: str) -> None:
    message = through_cdr(lidcam_objects(boxes3d([[1.5, y, 7, 4, 2, 1, 0.25]]), RIG.zones, stamp_ns=START_NS))
    found = {"intersection": message.objects_intersection, "circle": message.objects_circle}
    assert (message.num_intersection, message.num_circle) == (int(zone == "intersection"), int(zone == "circle"))
    assert [len(objects) for objects in found.values()] == [message.num_intersection, message.num_circle]
    if zone:
        (one,) = found[zone]
        assert (one.pos_x, one.pos_y, one.alpha) == (1.5, y, 0.25)


def test_without_zones_the_halves_of_the_predecessor_system_count() -> None:
    message = through_cdr(lidcam_objects(boxes3d([[9, 0, 0, 1, 1, 1, 0], [5, -500, 0, 1, 1, 1, 0]]), (), stamp_ns=1))
    assert [one.pos_x for one in message.objects_intersection] == [9]
    assert [one.pos_x for one in message.objects_circle] == [5]


def test_other_zones_have_no_field() -> None:
    zones = (Zone("car park", SQUARE.copy()), *RIG.zones)
    message = through_cdr(lidcam_objects(boxes3d([[1, 1, 0, 1, 1, 1, 0], [9, 1, 0, 1, 1, 1, 0]]), zones, stamp_ns=1))
    assert (message.num_intersection, message.num_circle) == (1, 0)
    assert message.objects_intersection[0].pos_x == 9
