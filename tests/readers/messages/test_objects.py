"""Objects of detectors in every format, Autoware's own fields, and lidcam's tracks, laid out by others' definitions."""

import math
from dataclasses import replace
from typing import Any

import builders
import numpy as np
import pytest
from object_messages import FORMATS, Format, Recorded, autoware_message, autoware_object, objects_message
from scipy.spatial.transform import Rotation
from track_messages import track, track_array

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.detections import decode_detected_boxes
from lidcam.readers.messages.objects import (
    ANY_HEADING_RAD2,
    DETECTED_OBJECTS,
    FoundObjects,
    ObjectClasses,
    decode_detected_objects,
    decode_tracks,
)

STAMP_NS = 1_700_000_000_123_456_789
CONFIG = Config()
CLASSES = ObjectClasses(CONFIG.class_id_of_label)
NO_VOLUME, NO_TURN = "box without a volume, or out of all bounds", "box without an orientation"


def decode(format_: Format, *objects: Recorded, **options: Any) -> FoundObjects:
    message = objects_message(format_, STAMP_NS, objects, **options)
    is_autoware = message.channel.msgtype in DETECTED_OBJECTS
    return (decode_detected_objects if is_autoware else decode_detected_boxes)(message, CLASSES)


@pytest.mark.parametrize("format_", FORMATS)
@pytest.mark.parametrize("count", [0, 40])
def test_the_same_objects_in_every_format(format_: Format, count: int) -> None:
    rng = np.random.default_rng(count)
    root = rng.normal(size=(count, 6, 6))
    covariances = root @ root.transpose(0, 2, 1)
    turns = Rotation.random(count, rng=rng) if count else None
    xyzw = np.zeros((0, 4)) if turns is None else turns.as_quat()
    centers, sizes = rng.normal(0, 30, (count, 3)), rng.uniform(0.1, 9, (count, 3))
    scores, names = rng.random(count, np.float32), ["car", "pedestrian", "truck", "bus"]
    objects = [
        Recorded(centers[k], names[k % 4], float(scores[k]), sizes[k], xyzw[k] * (1 + k), covariances[k])
        for k in range(count)
    ]
    found = decode(format_, *objects, frame_id="/lidar_top")
    assert (found.stamp_ns, found.frame_id, dict(found.unused)) == (STAMP_NS, "lidar_top", {})
    np.testing.assert_array_equal(found.boxes.centers, centers)
    np.testing.assert_array_equal(found.boxes.sizes, sizes)
    np.testing.assert_array_equal(found.boxes.covariances, covariances)
    np.testing.assert_array_equal(found.scores, scores)
    if turns is not None:
        np.testing.assert_allclose(found.boxes.rotations, turns.as_matrix(), atol=1e-12)
    assert [CONFIG.class_names[row] for row in found.class_ids] == [one.label for one in objects]


@pytest.mark.parametrize("format_", FORMATS)
def test_what_cannot_be_used_is_counted(format_: Format) -> None:
    found = decode(
        format_,
        Recorded((1, 2, 3)),
        Recorded((1, 2, 3), "unicorn"),
        Recorded((1, 2, np.nan)),
        Recorded((1, 1e9, 3)),
        Recorded((1, 2, 3), size=(4, 0, 1)),
        Recorded((1, 2, 3), size=(4, np.nan, 1)),
        Recorded((1, 2, 3), xyzw=(0, 0, 0, 0)),
        Recorded((1, 2, 3), xyzw=(1e300, 0, 0, 1)),
        Recorded((1, 2, 3), score=np.nan),
        Recorded((9, 2, 3), score=7.0),
    )
    label = "unicorn" if format_ in ("foxy", "galactic", "humble") else "77"
    unknown = f"class {label!r} is not configured"
    assert dict(found.unused) == {NO_VOLUME: 4, NO_TURN: 2, unknown: 1, "no class with a score": 1}
    assert found.boxes.centers[:, 0].tolist() == [1, 9]
    assert found.scores.tolist() == [0.75, 1.0]


@pytest.mark.parametrize(
    ("numbers", "label", "name"),
    [
        ("labels", "1", "car"),
        ("labels", "7", None),
        ("labels", " Car ", "car"),
        ("coco", "2", "car"),
        ("coco", "0", "pedestrian"),
        ("coco", "80", None),
        ("coco", "VAN", "truck"),
        ("autoware", "1", "car"),
        ("autoware", "5", "bicycle"),
        ("autoware", "0", None),
        ("autoware", "12", None),
        ("autoware", "9" * 30, None),
        ("autoware", "\u0661", None),
    ],
)
def test_what_labels_and_numbers_mean(numbers: Any, label: str, name: str | None) -> None:
    found = ObjectClasses(CONFIG.class_id_of_label, numbers).id_of(label)
    assert (None if found is None else CONFIG.class_names[found]) == name


BOX = {"center": {"orientation": {"w": 1.0}}, "size": {"x": 4.0, "y": 2.0, "z": 1.5}}


def hypothesis(label: str, score: float, variance: float = 0.0) -> builders.Fields:
    return {"hypothesis": {"class_id": label, "score": score}, "pose": {"covariance": np.eye(6).reshape(36) * variance}}


def test_score_and_covariance_are_those_of_the_best_hypothesis() -> None:
    results = [hypothesis("bus", 0.2, 1), hypothesis("car", 0.7, 2), hypothesis("truck", 0.7, 3)]
    results.append(hypothesis("lidar_points", 88, 4))
    body = {"header": builders.header(5, "a"), "detections": [{"results": results, "bbox": BOX}, {"bbox": BOX}]}
    found = decode_detected_boxes(builders.raw("/o", "vision_msgs/msg/Detection3DArray", body, 5), CLASSES)
    assert found.class_ids.tolist() == [CLASSES.id_of("car")]
    np.testing.assert_array_equal(found.boxes.covariances, 2 * np.eye(6)[None])
    assert dict(found.unused) == {"no class with a score": 1}


def test_too_many_boxes() -> None:
    many = builders.raw("/o", "vision_msgs/msg/Detection3DArray", {"detections": [{"bbox": BOX}] * 4}, 5)
    with pytest.raises(MessageError, match=r"/o: 4 boxes, expected at most 3: raise limit_scale"):
        decode_detected_boxes(many, CLASSES, limits=RecordingLimits(max_boxes=3))


# --- Autoware

HALF = np.sqrt(0.5)
LEFT = (0.0, 0.0, HALF, HALF)
"""A quarter turn to the left."""


def decode_autoware(*objects: builders.Fields) -> FoundObjects:
    return decode_detected_objects(autoware_message(5, objects), CLASSES)


def one(**changed: Any) -> dict[str, Any]:
    return autoware_object(Recorded((10.0, 20.0, 1.0), xyzw=LEFT, covariance=np.diag([1, 2, 3, 4, 5, 6])), **changed)


def test_the_likeliest_class_counts() -> None:
    named = one()
    named["classification"] = [{"label": n, "probability": p} for n, p in ((0, 0.1), (3, 0.5), (2, 0.5), (1, 0.2))]
    nameless = one()
    nameless["classification"] = []
    found = decode_autoware(named, nameless)
    assert found.class_ids.tolist() == [CLASSES.id_of("bus")]
    assert dict(found.unused) == {"no class with a score": 1}


def test_covariance_of_what_is_known() -> None:
    whole, no_position, no_heading = decode_autoware(
        one(), one(has_position_covariance=False), one(orientation_availability=0)
    ).boxes.covariances
    np.testing.assert_array_equal(whole, np.diag([1, 2, 3, 4, 5, 6]))
    np.testing.assert_array_equal(no_position, np.zeros((6, 6)))
    np.testing.assert_array_equal(no_heading, np.diag([1, 2, 3, 4, 5, ANY_HEADING_RAD2]))


def test_an_object_without_an_orientation_at_all() -> None:
    lying = Recorded((1, 2, 3), xyzw=(0, 0, 0, 0))
    found = decode_autoware(autoware_object(lying, orientation_availability=0), autoware_object(lying))
    np.testing.assert_array_equal(found.boxes.rotations, np.eye(3)[None])
    assert dict(found.unused) == {"box without an orientation": 1}


def test_a_polygon_becomes_the_box_around_it() -> None:
    corners = [{"x": x, "y": y} for x, y in ((-1.0, -0.5), (3.0, -0.5), (3.0, 0.5), (1.0, 1.5))]
    no_place = {"points": [{"x": np.nan, "y": 0.0}, {"x": 1.0, "y": 1.0}]}
    found = decode_autoware(
        one(type=2, footprint={"points": corners}), one(type=2), one(type=1), one(type=2, footprint=no_place)
    )
    np.testing.assert_allclose(found.boxes.sizes, np.tile([4, 2, 1.5], (4, 1)))
    # (1, 0.5) from the object's origin, turned to the left
    centers = np.array([[9.5, 21, 1], *[[10, 20, 1]] * 3])
    np.testing.assert_allclose(found.boxes.centers, centers, atol=1e-12)


def test_without_a_recorded_definition_that_of_autoware_is_taken() -> None:
    message = autoware_message(5, [one()])
    bare = message._replace(channel=replace(message.channel, definition=""))
    assert len(decode_detected_objects(bare, CLASSES).boxes) == 1


# --- tracks


def test_every_field_is_read_from_its_place() -> None:
    first = track(7, (3.0, -4.0), 0.5, source="predicted", age={"sec": 2, "nanosec": 500_000_000}, front_known=True)
    found = decode_tracks(track_array([first, track(1 << 40, source="camera")], stamp_ns=STAMP_NS))
    assert (found.stamp_ns, found.frame_id, len(found), dict(found.unused)) == (STAMP_NS, "site", 2, {})
    tracks = found.tracks
    np.testing.assert_array_equal(tracks.ids, [7, 1 << 40])
    np.testing.assert_array_equal(tracks.velocities, [[3, -4], [0, 0]])
    np.testing.assert_array_equal(tracks.velocity_covariances[0], np.diag([0.25, 0.0625]))
    np.testing.assert_array_equal(tracks.yaw_rates, [0.5, 0])
    np.testing.assert_array_equal(tracks.yaw_rate_variances, [1 / 64] * 2)
    np.testing.assert_array_equal(tracks.existence, [0.75, 0.75])
    np.testing.assert_array_equal(tracks.ages_s, [2.5, 0])
    np.testing.assert_array_equal(tracks.fronts_known, [True, False])
    np.testing.assert_array_equal(found.is_predicted, [True, False])


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (track(0), "track without a number"),
        (track(5, (9.0, 9.0)), "track whose number another one has"),
        (track(6, (math.nan, 0.0)), "track whose motion is not finite"),
        (track(6, yaw_rate=math.inf), "track whose motion is not finite"),
        (track(6, deviations=(1.0, 1e100, 1.0)), "track whose motion is not finite"),
        (track(6, existence=math.nan), "track whose motion is not finite"),
    ],
)
def test_tracks_that_cannot_be_used_are_counted(bad: dict[str, Any], reason: str) -> None:
    found = decode_tracks(track_array([track(5, (1.0, 2.0)), bad, track(4)], stamp_ns=STAMP_NS))
    np.testing.assert_array_equal(found.tracks.ids, [5, 4])
    np.testing.assert_array_equal(found.tracks.velocities, [[1, 2], [0, 0]])
    assert dict(found.unused) == {reason: 1}


def test_messages_without_tracks() -> None:
    many = track_array([track(number) for number in range(1, 4)], stamp_ns=STAMP_NS)
    with pytest.raises(MessageError, match=r"/tracks: 3 boxes, expected at most 2"):
        decode_tracks(many, limits=RecordingLimits(max_boxes=2))
    with pytest.raises(MessageError, match="are not a valid lidcam_msgs/msg/TrackArray"):
        decode_tracks(many._replace(data=many.data[:-9]))
    with pytest.raises(MessageError, match="expected lidcam_msgs/msg/TrackArray, found sensor_msgs/msg/Image"):
        decode_tracks(builders.raw("/tracks", "sensor_msgs/msg/Image", {}, STAMP_NS))
