import numpy as np
import pytest
from frames import CONFIG, START_NS, frame, through_cdr

from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.messages.scene import placed_scene, truth_scene

CAMERA, LIDAR = Source.CAMERA, Source.LIDAR


@pytest.mark.parametrize("labels", [(), ("car",), ("car", "van")])
def test_the_edges_of_every_true_object_with_its_class(labels: tuple[str, ...]) -> None:
    n = len(labels)
    sizes, centers = np.full((n, 3), [4.0, 2.0, 1.5]), np.arange(3.0 * n).reshape(n, 3)
    truth = TrueBoxes("/truth", START_NS, START_NS, "odom", centers, sizes, np.full(n, np.pi / 2), labels)
    read = through_cdr(truth_scene(truth))
    assert [one.type for one in read.deletions] == [1]
    told = [(pair.key, pair.value) for one in read.entities for pair in one.metadata]
    assert told == [("class", label) for label in labels]
    for row, entity in enumerate(read.entities):
        assert (entity.frame_id, entity.timestamp.nanosec) == ("odom", START_NS % 10**9)
        (lines,) = entity.lines
        corners = np.array([[point.x, point.y, point.z] for point in lines.points])
        # turned by 90 degrees: the length lies along y
        np.testing.assert_allclose(corners.max(0) - corners.min(0), [2, 4, 1.5])
        np.testing.assert_allclose((corners.max(0) + corners.min(0)) / 2, np.arange(3.0) + 3 * row)
        assert len(lines.indices) == 24


@pytest.mark.parametrize("count", [0, 1, 2])
def test_each_box_has_its_edges_an_ellipse_and_a_label(count: int) -> None:
    boxes = frame(sources=[CAMERA] * count + [LIDAR] * (3 - count)).detections.placed
    assert boxes is not None
    found = through_cdr(placed_scene(boxes, CONFIG.class_names, stamp_ns=START_NS))
    assert len(found.deletions) == 1
    entities = found.entities
    assert [entity.id for entity in entities] == [f"placed-{row}" for row in range(count)]
    for row, entity in enumerate(entities):
        edges, ellipse = entity.lines
        assert (edges.type, ellipse.type) == (edges.LINE_LIST, edges.LINE_LOOP)
        middle = np.mean([(point.x, point.y) for point in ellipse.points], axis=0)
        np.testing.assert_allclose(middle, boxes.centers[row, :2], atol=1e-9)
        (text,) = entity.texts
        assert text.text == ["car 0.90", "pedestrian 0.50"][row]
        assert text.pose.position.z > boxes.centers[row, 2] + boxes.sizes[row, 2] / 2
        assert entity.timestamp.nanosec == START_NS % 10**9
