from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from object_messages import Format, Recorded, objects_message
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.errors import FrameError, MessageError
from lidcam.pipeline.core.frame import Decoded, SensorBundle
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import RecordedDetector, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.streams.recorded3d import RecordedBoxes3D

MS = 1_000_000
NOW_NS = 1_600_000_000_000_000_000
LEFT = Rotation.from_euler("z", 90, degrees=True)
LIDAR = Transform.from_quaternion("base_link", "lidar", (1, 0, 2), LEFT.as_quat())
HALL = Transform.from_quaternion("map", "hall", (100, 0, 0), (0, 0, 0, 1))
DETECTOR = RecordedDetector(
    "objects",
    "/detector/objects",
    "lidar",
    {"lidar": LIDAR, "base_link": Transform.identity("base_link", "base_link")},
    {"hall": HALL, "map": Transform.identity("map", "map")},
)
RIG = Rig("base_link", (), (), (), detectors=(DETECTOR,))


def motion() -> PoseSamples:
    """10 m/s along the map's y, which the vehicle looks along."""
    stamps = NOW_NS + 20 * MS * np.arange(-20, 6)
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, :3, :3] = LEFT.as_matrix()
    poses[:, 1, 3] = 10 * (stamps - NOW_NS) / 1e9
    return PoseSamples("base_link", "map", stamps, poses)


def bundle(*messages: RawMessage, poses: PoseSamples | None = None) -> SensorBundle:
    return SensorBundle(0, NOW_NS, NOW_NS, {message.topic: message for message in messages}, poses)


def decode(
    *objects: Recorded, stamp_ns: int = NOW_NS, poses: PoseSamples | None = None, on_bad: Any = "skip", **options: Any
) -> Decoded[Boxes3D]:
    options = {"format_": "humble", "frame_id": "lidar"} | options
    message = objects_message(options.pop("format_"), stamp_ns, objects, **options)
    return RecordedBoxes3D(RIG, Config(), on_bad=on_bad)(bundle(message, poses=poses))


def centers(found: Decoded[Boxes3D]) -> F64:
    return found["objects"].centers


@pytest.mark.parametrize("format_", ["humble", "autoware"])
def test_boxes_come_to_the_site_frame(format_: Format) -> None:
    found = decode(Recorded((5, 1, 0.5), "bus", 0.5), frame_id="/lidar", format_=format_)
    boxes = found["objects"]
    assert (boxes.stamp_ns, boxes.frame_id, found.drops, dict(found.unused_boxes)) == (NOW_NS, "base_link", (), {})
    np.testing.assert_allclose(boxes.centers, [[0, 5, 2.5]], atol=1e-12)
    np.testing.assert_allclose(boxes.yaws, [np.pi / 2])
    np.testing.assert_array_equal(boxes.sizes, [[4, 2, 1.5]])
    np.testing.assert_array_equal(boxes.scores, np.array([0.5], np.float32))
    np.testing.assert_array_equal(boxes.covariances, np.diag([0.3**2, 0.3**2, np.radians(10.0) ** 2])[None])
    assert (boxes.sources.tolist(), boxes.measured_ns.tolist()) == ([Source.LIDAR], [NOW_NS])
    assert boxes.class_ids.tolist() == [Config().class_id_of_label["bus"]]


def test_motion_of_another_frame_is_refused() -> None:
    with pytest.raises(FrameError, match="expected poses of the site frame 'base_link', got 'lidar'"):
        decode(Recorded((5, 1, 0.5)), stamp_ns=NOW_NS - 100 * MS, poses=replace(motion(), frame_id="lidar"))


def test_boxes_of_another_moment_move_with_the_vehicle() -> None:
    found = decode(Recorded((5, 1, 0.5)), stamp_ns=NOW_NS - 100 * MS, poses=motion(), frame_id="lidar")
    np.testing.assert_allclose(centers(found), [[-1, 5, 2.5]], atol=1e-9)  # the vehicle went 1 m further
    assert found["objects"].measured_ns.tolist() == [NOW_NS - 100 * MS]
    assert found["objects"].stamp_ns == NOW_NS


@pytest.mark.parametrize("stamp_ns", [NOW_NS - 2_000 * MS, NOW_NS + 900 * MS])
def test_boxes_stay_where_the_motion_is_not_known(stamp_ns: int) -> None:
    for poses in (motion(), None):
        found = decode(Recorded((5, 1, 0.5)), stamp_ns=stamp_ns, poses=poses, frame_id="lidar")
        np.testing.assert_allclose(centers(found), [[0, 5, 2.5]], atol=1e-12)


@pytest.mark.parametrize("stamp_ns", [NOW_NS, NOW_NS - 80 * MS])
def test_boxes_in_the_map_are_where_the_vehicle_is_from_there(stamp_ns: int) -> None:
    found = decode(Recorded((0, 7, 1)), stamp_ns=stamp_ns, poses=motion(), frame_id="map")
    np.testing.assert_allclose(centers(found), [[7, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(found["objects"].yaws, [-np.pi / 2])
    found = decode(Recorded((-100, 7, 1)), stamp_ns=stamp_ns, poses=motion(), frame_id="hall")
    np.testing.assert_allclose(centers(found), [[7, 0, 1]], atol=1e-9)


@pytest.mark.parametrize(
    ("frame", "poses", "reason"),
    [
        ("map", None, "in frame 'map', and where the site frame was in it is not known"),
        ("moon", motion(), "in frame 'moon', which nothing joins"),
    ],
)
def test_frames_that_nothing_joins(frame: str, poses: PoseSamples | None, reason: str) -> None:
    found = decode(Recorded((0, 7, 1)), poses=poses, frame_id=frame)
    assert dict(found) == {}
    assert [(drop.topic, drop.reason) for drop in found.drops] == [("/detector/objects", "cannot be decoded")]
    with pytest.raises(MessageError, match=reason):
        decode(Recorded((0, 7, 1)), poses=poses, frame_id=frame, on_bad="fail")


def test_what_is_not_used_is_counted() -> None:
    found = decode(Recorded((1, 1, 1), score=0.05), Recorded((1, 1, 1), "cow"), Recorded((1, 1, 1), score=0.07))
    assert dict(found.unused_boxes) == {"class 'cow' is not configured": 1, "score under detect3d.min_score (0.07)": 1}
    assert len(found["objects"]) == 1


def test_a_bad_message_is_one_drop() -> None:
    message = objects_message("humble", NOW_NS, [])
    found = RecordedBoxes3D(RIG, Config(), on_bad="skip")(bundle(message._replace(data=message.data[:9])))
    assert ([drop.reason for drop in found.drops], dict(found)) == (["cannot be decoded"], {})
