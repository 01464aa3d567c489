from typing import Any

import numpy as np
import pytest
from frames import CONFIG, START_NS, frame

from pipeline.core.detections import Boxes3D, Source
from pipeline.core.ros.messages import ROS2
from writers.messages.edge_scenes import placed_scene

CAMERA, LIDAR = Source.CAMERA, Source.LIDAR


def scene(boxes: Boxes3D) -> Any:
    message = placed_scene(boxes, CONFIG.class_names, stamp_ns=START_NS)
    return ROS2.deserialize(bytes(ROS2.serialize(message)), message.__msgtype__)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_each_box_has_its_edges_an_ellipse_and_a_label(count: int) -> None:
    boxes = frame(sources=[CAMERA] * count + [LIDAR] * (3 - count)).detections.placed
    assert boxes is not None
    found = scene(boxes)
    assert len(found.deletions) == 1
    entities = found.entities
    assert [entity.id for entity in entities] == [f"placed-{row}" for row in range(count)]
    for row, entity in enumerate(entities):
        edges, ellipse = entity.lines
        assert (edges.type, ellipse.type) == (edges.LINE_LIST, edges.LINE_LOOP)
        np.testing.assert_allclose(
            np.mean([(point.x, point.y) for point in ellipse.points], axis=0), boxes.centers[row, :2], atol=1e-9
        )
        (text,) = entity.texts
        assert text.text == ["car 0.90", "pedestrian 0.50"][row]
        assert text.pose.position.z > boxes.centers[row, 2] + boxes.sizes[row, 2] / 2
        assert entity.timestamp.nanosec == START_NS % 10**9
