from dataclasses import replace
from typing import Any

import builders
import numpy as np
from object_messages import Recorded, autoware_message, autoware_object

from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.objects import ANY_HEADING_RAD2, FoundObjects, ObjectClasses, decode_detected_objects

CLASSES = ObjectClasses(Config())
HALF = np.sqrt(0.5)
LEFT = (0.0, 0.0, HALF, HALF)
"""A quarter turn to the left."""


def decode(*objects: builders.Fields) -> FoundObjects:
    return decode_detected_objects(autoware_message(5, objects), CLASSES)


def one(**changed: Any) -> dict[str, Any]:
    return autoware_object(Recorded((10.0, 20.0, 1.0), xyzw=LEFT, covariance=np.diag([1, 2, 3, 4, 5, 6])), **changed)


def test_the_likeliest_class_counts() -> None:
    named = one()
    named["classification"] = [{"label": n, "probability": p} for n, p in ((0, 0.1), (3, 0.5), (2, 0.5), (1, 0.2))]
    nameless = one()
    nameless["classification"] = []
    found = decode(named, nameless)
    assert found.class_ids.tolist() == [CLASSES.id_of("bus")]
    assert dict(found.unused) == {"no class with a score": 1}


def test_covariance_of_what_is_known() -> None:
    whole, no_position, no_heading = decode(
        one(), one(has_position_covariance=False), one(orientation_availability=0)
    ).boxes.covariances
    np.testing.assert_array_equal(whole, np.diag([1, 2, 3, 4, 5, 6]))
    np.testing.assert_array_equal(no_position, np.zeros((6, 6)))
    np.testing.assert_array_equal(no_heading, np.diag([1, 2, 3, 4, 5, ANY_HEADING_RAD2]))


def test_an_object_without_an_orientation_at_all() -> None:
    lying = Recorded((1, 2, 3), xyzw=(0, 0, 0, 0))
    found = decode(autoware_object(lying, orientation_availability=0), autoware_object(lying))
    np.testing.assert_array_equal(found.boxes.rotations, np.eye(3)[None])
    assert dict(found.unused) == {"box without an orientation": 1}


def test_a_polygon_becomes_the_box_around_it() -> None:
    corners = [{"x": x, "y": y} for x, y in ((-1.0, -0.5), (3.0, -0.5), (3.0, 0.5), (1.0, 1.5))]
    no_place = {"points": [{"x": np.nan, "y": 0.0}, {"x": 1.0, "y": 1.0}]}
    found = decode(
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
