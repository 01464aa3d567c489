from typing import Any

from compared_frames import Row, objects

from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.core.settings.evaluate import CompareConfig
from lidcam.pipeline.evaluation.comparison.object_changes import KnownClasses, Tracks, source_changes, source_objects
from lidcam.pipeline.evaluation.evaluation_frame import SourceBoxes
from lidcam.writers.messages.compared import compared_scene, empty_scene
from lidcam.writers.palette import CHANGED, EQUAL, LOST, NEW

NAMES = [prior.name for prior in ROAD_CLASSES]
KNOWN = KnownClasses.of(ROAD_CLASSES, NAMES)


def car(x: float, yaw: float = 0.0) -> Row:
    return (x, 0.0, 0.8, 4.0, 1.8, 1.5, yaw)


def drawn(first: SourceBoxes, second: SourceBoxes) -> Any:
    sides = source_objects(first, KNOWN), source_objects(second, KNOWN)
    changes = source_changes(*sides, CompareConfig(), Tracks())
    return through_cdr(compared_scene(*sides, changes, NAMES, stamp_ns=7))


def through_cdr(message: Any) -> Any:
    return ROS2.deserialize(ROS2.serialize(message), message.__msgtype__)


def test_colours_say_what_became_of_an_object() -> None:
    first, second = objects(car(0), car(20), car(40)), objects(car(0), car(20.5, 1.0), car(60))
    scene = drawn(first, second)
    assert [one.type for one in scene.deletions] == [1], "all that was drawn before"
    found = {
        entity.id: (
            entity.lines[0].pose.position.x,
            [round(value, 2) for value in (entity.lines[0].color.r, entity.lines[0].color.g, entity.lines[0].color.b)],
            [text.text for text in entity.texts],
        )
        for entity in scene.entities
    }
    assert found == {
        "equal-0": (0.0, list(EQUAL), []),
        "before-0": (20.0, list(CHANGED), []),
        "lost-0": (40.0, list(LOST), ["car lost"]),
        "new-0": (60.0, list(NEW), ["car new"]),
        "changed-0": (20.5, list(CHANGED), ["car moved, turned"]),
    }
    assert {entity.frame_id for entity in scene.entities} == {"site"}
    assert {entity.metadata[1].value for entity in scene.entities} == {
        "equal",
        "before",
        "lost",
        "new",
        "moved, turned",
    }


def test_nothing_is_drawn_of_no_objects() -> None:
    for scene in (drawn(objects(), objects()), through_cdr(empty_scene(7))):
        assert not scene.entities
        assert len(scene.deletions) == 1
        assert scene.deletions[0].timestamp.nanosec == 7
