from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pipeline.core.ros.messages import ROS2
from pipeline.core.true_boxes import TrueBoxes
from writers.messages.edge_scenes import truth_scene, truth_scene_topic

STAMP_NS = 1_700_000_000_123_456_789


def boxes(labels: tuple[str, ...]) -> TrueBoxes:
    n = len(labels)
    sizes = np.full((n, 3), [4.0, 2.0, 1.5])
    centers = np.arange(3.0 * n).reshape(n, 3)
    return TrueBoxes("/truth", STAMP_NS, STAMP_NS, "odom", centers, sizes, np.full(n, np.pi / 2), labels)


def test_the_edges_of_every_object_with_its_class() -> None:
    message = truth_scene(boxes(("car", "van")))
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(ROS2.definition(message.__msgtype__), message.__msgtype__))
    read: Any = store.deserialize_cdr(ROS2.serialize(message), message.__msgtype__)
    assert [one.type for one in read.deletions] == [1]
    assert [one.texts[0].text for one in read.entities] == ["car", "van"]
    for row, entity in enumerate(read.entities):
        assert (entity.frame_id, entity.timestamp.nanosec) == ("odom", STAMP_NS % 10**9)
        (lines,) = entity.lines
        corners = np.array([[point.x, point.y, point.z] for point in lines.points])
        # turned by 90 degrees: the length lies along y
        np.testing.assert_allclose(corners.max(0) - corners.min(0), [2, 4, 1.5])
        np.testing.assert_allclose((corners.max(0) + corners.min(0)) / 2, np.arange(3.0) + 3 * row)
        assert len(lines.indices) == 24
        assert entity.texts[0].pose.position.z > corners[:, 2].max()


def test_without_objects_it_removes_those_before() -> None:
    message = ROS2.deserialize(ROS2.serialize(truth_scene(boxes(()))), "foxglove_msgs/msg/SceneUpdate")
    assert (len(message.deletions), message.entities) == (1, [])


def test_its_topic_lies_below_that_of_the_truth() -> None:
    assert truth_scene_topic("/ground_truth/objects") == "/ground_truth/objects/scene"
