from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
import rig_messages
from builders import odometry, raw
from message_layouts import message_of_layout
from object_messages import Recorded, boxes_message, objects_message
from rig_messages import cloud, static

from lidcam.pipeline.core.errors import CalibrationError, RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.rig.discovery import Discovery

MS = 1_000_000
BOXES = "vision_msgs/msg/Detection3DArray"


def boxes(topic: str = "/detector/objects", frame: str = "lidar") -> RawMessage:
    return boxes_message("humble", 5, [Recorded((1, 2, 3))], topic=topic, frame_id=frame)


def odom(i: int, frame: str = "map", child: str = "base_link") -> RawMessage:
    fields = odometry(stamp_ns=i * 20 * MS, position=(0.2 * i, 0, 0), frame_id=frame, child_frame_id=child)
    return raw("/odom", "nav_msgs/msg/Odometry", fields, i * 20 * MS)


def discover(messages: Iterable[RawMessage], rig: dict[str, Any] | None = None, **sections: Any) -> Discovery:
    return rig_messages.discover(messages, rig, **{"detect3d": {"method": "recorded"}} | sections)


def topics(found: Discovery) -> list[str]:
    return [detector.topic for detector in found.rig.detectors]


MOUNT = static(("base_link", "lidar", (1, 0, 2)), ("lidar", "tool", (0, 3, 0)))


def test_detectors_are_used_only_if_asked_for() -> None:
    found = discover([MOUNT, cloud(), boxes(), boxes("/ground_truth/objects")], detect3d={})
    assert (found.rig.detectors, found.faults) == ((), ())
    (note,) = found.notes
    assert note.startswith("/detector/objects: 3D boxes, not used; --set detect3d.method=recorded takes them")


def test_all_that_are_neither_truth_nor_excluded_nor_lidcams_own() -> None:
    names = ("/b_10/objects", "/b_9/objects", "/ground_truth/objects", "/x/gt", "/lidar/detections", "/old/objects")
    found = discover([MOUNT, cloud(), *map(boxes, names)], topics={"exclude": ["/old/*"]})
    assert topics(found) == ["/b_9/objects", "/b_10/objects"]
    assert [detector.name for detector in found.rig.detectors] == ["b_9_objects", "b_10_objects"]
    assert [source.sensor for source in found.sources] == ["lidar", "b_9_objects", "b_10_objects"]
    assert found.rig.sensor_of_topic["/b_9/objects"] == "b_9_objects"


def test_named_topics_are_taken_whatever_they_are_called() -> None:
    names = ["/lidar/detections", "/ground_truth/objects", "/none"]
    messages = [MOUNT, cloud(), boxes("/lidar/detections"), boxes("/ground_truth/objects"), boxes("/other")]
    found = discover(messages, topics={"boxes3d": names})
    assert topics(found) == names[:2]
    (fault,) = found.faults
    assert fault.topic == "/none"
    assert "no 3D boxes topic of this name; it has /lidar/detections, /other" in fault.reason


@pytest.mark.parametrize(("frame", "place"), [("lidar", [1, 0, 2]), ("/tool", [1, 3, 2]), ("base_link", [0, 0, 0])])
def test_frames_that_are_fixed_to_the_site(frame: str, place: list[float]) -> None:
    (detector,) = discover([MOUNT, cloud(), boxes(frame=frame)]).rig.detectors
    assert detector.frame_id == frame.lstrip("/")
    np.testing.assert_allclose(detector.T_site_frame[detector.frame_id].translation, place)
    assert {*detector.T_site_frame} == {"base_link", "lidar", "tool"}
    assert not detector.T_fixed_frame


NO_HEADERS = {
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/ObjectHypothesisWithPose": "string id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/Detection3D": "ObjectHypothesisWithPose[] results\nBoundingBox3D bbox",
    BOXES: "std_msgs/Header header\nDetection3D[] detections",
}
PLAIN: dict[str, Any] = {"detections": [{"bbox": {}}]}


@pytest.mark.parametrize(
    ("message", "frame"),
    [
        (boxes(frame=""), "base_link"),
        (raw("/detector/objects", BOXES, {"detections": [{"header": {"frame_id": "/tool"}, "bbox": {}}]}, 5), "tool"),
        (message_of_layout(BOXES, NO_HEADERS, "cdr", PLAIN, topic="/detector/objects", stamp_ns=5), "base_link"),
    ],
)
def test_boxes_without_a_frame_have_that_of_the_first_box_else_the_site_frame(message: RawMessage, frame: str) -> None:
    found = discover([MOUNT, cloud(), message])
    assert found.rig.detectors[0].frame_id == frame
    assert len(found.notes) == (frame == "base_link")


def test_a_frame_that_nothing_joins_is_a_fault() -> None:
    found = discover([MOUNT, cloud(), boxes(frame="moon"), boxes("/other")])
    assert topics(found) == ["/other"]
    (fault,) = found.faults
    assert fault.topic == "/detector/objects"
    assert "its boxes are in frame 'moon', which nothing joins with the site frame 'base_link'" in fault.reason
    assert "transforms: {base_link: {moon: {" in fault.reason


@pytest.mark.parametrize("frame", ["map", "hall"])
def test_the_frame_in_which_the_site_moves(frame: str) -> None:
    edges = static(("base_link", "lidar", (1, 0, 2)), ("map", "hall", (100, 0, 0)))
    found = discover([edges, cloud(), boxes(frame=frame), odom(0), odom(1)])
    (detector,) = found.rig.detectors
    assert (found.faults, {*detector.T_fixed_frame}) == ((), {"map", "hall"})
    np.testing.assert_allclose(detector.T_fixed_frame["hall"].translation, [100, 0, 0])
    assert found.sources[1].extrinsics == f"motion of base_link in {frame}"


def test_a_forest_of_frames_is_joined_as_tf_joins_it() -> None:
    rng = np.random.default_rng(2)
    edges = [(f"f{rng.integers(0, k)}", f"f{k}", tuple(rng.normal(size=3))) for k in range(1, 40)]
    others = [("x0", "x1", (1, 0, 0)), ("c0", "c1", (1, 0, 0)), ("c1", "c0", (1, 0, 0))]
    messages = [static(*edges, *others), cloud(frame="f7"), boxes(frame="f30")]
    found = discover(messages, rig={"site_frame": "f20"})
    (detector,) = found.rig.detectors
    assert {*detector.T_site_frame} == {f"f{k}" for k in range(40)}
    for frame, pose in detector.T_site_frame.items():
        expected = found.transforms.lookup("f20", frame)
        np.testing.assert_allclose(pose.matrix, expected.matrix, atol=1e-12)


# --- recordings without clouds


def test_the_vehicle_is_the_site_if_there_is_one() -> None:
    for frame in ("base_link", "map", "lidar"):
        found = discover([MOUNT, odom(0), odom(1), boxes(frame=frame)])
        assert (found.rig.site_frame, topics(found), found.faults) == ("base_link", ["/detector/objects"], ())
    found = discover([boxes(frame="map")])
    assert (found.rig.site_frame, found.rig.lidars, topics(found)) == ("map", (), ["/detector/objects"])


FOUND = r"found 3D boxes: /detector/objects .*--set detect3d\.method=recorded"


@pytest.mark.parametrize(
    ("messages", "rig", "sections", "reason"),
    [
        ([boxes(), boxes("/ground_truth/objects")], {}, {"detect3d": {}}, FOUND),
        ([objects_message("autoware", 5, [Recorded((1, 2, 3))])], {}, {"detect3d": {}}, FOUND),
        ([boxes("/gt"), boxes("/lidar/detections")], {}, {}, r"found neither; name one with topics\.boxes3d"),
        ([MOUNT, boxes(frame="moon")], {}, {}, r"no lidar is usable .*frame 'moon'"),
        ([MOUNT, cloud()], {"lidars": {}}, {}, "no lidar: name one"),
    ],
)
def test_without_clouds(messages: list[RawMessage], rig: dict[str, Any], sections: dict[str, Any], reason: str) -> None:
    with pytest.raises((CalibrationError, RecordingError), match=reason):
        discover(messages, rig, **sections)


def test_a_rig_file_without_lidars_goes_with_boxes() -> None:
    assert topics(discover([MOUNT, cloud(), boxes()], {"lidars": {}})) == ["/detector/objects"]
