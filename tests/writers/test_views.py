"""What people look at: scenes, markers, annotations, diagnostics."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frames import CONFIG, RIG, START_NS, frame

from pipeline.core.frame import Missing
from pipeline.core.messages import Drop
from pipeline.core.ros.typestores import message_types
from writers.messages.annotations import image_annotations
from writers.messages.diagnostics import diagnostics
from writers.messages.scene import marker_array, scene_update
from writers.palette import CAMERA_ONLY, LIDAR_ONLY, MATCHED

NAMES = CONFIG.class_names


def through_cdr(message: Any) -> Any:
    store, msgtype = message_types(2), message.__msgtype__
    return store.deserialize_cdr(bytes(store.serialize_cdr(message, msgtype)), msgtype)


@pytest.mark.parametrize("objects", [0, 1, 3])
def test_a_scene_starts_with_the_deletion_of_the_one_before(objects: int) -> None:
    result = frame(objects=objects)
    scene = through_cdr(scene_update(result, NAMES))
    assert [(d.type, d.id) for d in scene.deletions] == [(scene.deletions[0].ALL, "")]
    assert len({entity.id for entity in scene.entities}) == objects
    for row, entity in enumerate(scene.entities):
        (cube,), (text,) = entity.cubes, entity.texts
        np.testing.assert_allclose([cube.size.x, cube.size.y, cube.size.z], result.fused.objects.sizes[row])
        np.testing.assert_allclose(
            [cube.pose.position.x, cube.pose.position.z], result.fused.objects.centers[row, [0, 2]]
        )
        assert text.pose.position.z > cube.pose.position.z + cube.size.z / 2
        assert (entity.frame_id, entity.timestamp.nanosec) == ("site", START_NS % 10**9)
        assert text.text.startswith(NAMES[result.fused.objects.class_ids[row]])


def test_confirmed_objects_are_denser_and_say_by_how_many_cameras() -> None:
    entities = through_cdr(scene_update(frame(), NAMES)).entities  # confirmed by 2, 1 and 0 cameras
    alphas = [entity.cubes[0].color.a for entity in entities]
    assert alphas[0] == alphas[1] > alphas[2] > 0
    assert [entity.texts[0].text for entity in entities] == [
        "car 0.90 (2 cam)",
        "pedestrian 0.50 (1 cam)",
        "truck 0.25",
    ]


@pytest.mark.parametrize("objects", [0, 3])
def test_markers_delete_all_first(objects: int) -> None:
    markers = through_cdr(marker_array(frame(objects=objects), NAMES)).markers
    assert [marker.action for marker in markers] == [3] + [0] * (2 * objects)
    assert len({(marker.ns, marker.id) for marker in markers[1:]}) == 2 * objects
    assert all(marker.header == markers[0].header for marker in markers)
    assert all(marker.text for marker in markers if marker.ns == "labels")


def test_annotations_of_a_camera_with_a_match() -> None:
    result = frame()
    boxes, matches = result.detections.cameras["left"], result.matches["left"]
    drawn = through_cdr(image_annotations(boxes, matches, NAMES, stamp_ns=boxes.stamp_ns))
    stamps = {(part.timestamp.sec, part.timestamp.nanosec) for part in (drawn, *drawn.points, *drawn.texts)}
    assert stamps == {divmod(boxes.stamp_ns, 10**9)}
    colors = [(part.outline_color.r, part.outline_color.g, part.outline_color.b) for part in drawn.points]
    assert colors == [MATCHED, LIDAR_ONLY, MATCHED, CAMERA_ONLY]  # two projections in view, then two 2D boxes
    assert [text.text for text in drawn.texts] == ["lidar", "car 0.75, IoU 0.62", "pedestrian 0.50"]
    corners = [(point.x, point.y) for point in drawn.points[2].points]
    assert corners == [(200.5, 150), (300.25, 150), (300.25, 250), (200.5, 250)]
    assert all(part.type == part.LINE_LOOP for part in drawn.points)


def test_annotations_without_boxes() -> None:
    drawn = through_cdr(image_annotations(None, None, NAMES, stamp_ns=START_NS))
    assert (drawn.points, drawn.texts, drawn.timestamp.nanosec) == ([], [], START_NS % 10**9)


def test_diagnostics() -> None:
    drops = (Drop("/left/image", 1, "cannot be decoded", "12 bytes"), Drop("/left/image", 2, "too late"))
    result = frame(4, drops=drops[:1])
    late = replace(result.bundle, dropped_before={("/right/image", "no partner"): 3})
    message = through_cdr(diagnostics(replace(result, bundle=late), RIG, drops[1:]))
    found = {status.name: [(pair.key, pair.value) for pair in status.values] for status in message.status}
    assert ("skew_ms", "5.000") in found["lidcam: synchronisation"]
    assert ("offset_ms /left/image", "1.000") in found["lidcam: synchronisation"]
    assert ("frame", "4") in found["lidcam: synchronisation"]
    assert ("left out /right/image", "3: no partner") in found["lidcam: synchronisation"]
    assert ("points outliers", "10") in found["lidcam: cloud"]
    assert ("motion compensated", "lidar1") in found["lidcam: cloud"]
    for pair in (("fused", "3"), ("confirmed by cameras", "2"), ("detected left", "2"), ("matched right", "0")):
        assert pair in found["lidcam: objects"]
    assert found["lidcam: dropped messages"] == [
        ("/left/image", "cannot be decoded: 12 bytes"),
        ("/left/image", "too late"),
    ]
    assert [status.level for status in message.status] == [0, 0, 0, 1]


@pytest.mark.parametrize(("why", "level"), [(Missing.NOT_NEAR, 0), (Missing.SILENT, 1)])
def test_diagnostics_name_the_sensors_that_are_missing(why: Missing, level: int) -> None:
    result = frame(4)
    kept = {topic: message for topic, message in result.bundle.messages.items() if topic != "/left/image"}
    partial = replace(result, bundle=replace(result.bundle, messages=kept, missing={"/left/image": why}))
    status = through_cdr(diagnostics(partial, RIG, ())).status[0]
    assert (status.message, status.level) == ("skew 5.000 ms, without left", level)
    assert ("missing left", why) in [(pair.key, pair.value) for pair in status.values]
