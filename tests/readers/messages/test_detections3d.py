import math

import builders
import numpy as np
from builders import Fields

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.messages.detections import Detections3D, decode_detections3d, track_ids

STAMP_NS = 1_700_000_000_123_456_789
MSGTYPE = "vision_msgs/msg/Detection3DArray"


def detection(
    *classes: tuple[str, float],
    size: tuple[float, ...] = (4.0, 2.0, 1.5),
    id_: str = "",
    x: float = 1.0,
    quaternion: tuple[float, ...] = (0, 0, 0, 1),
) -> Fields:
    return {
        "results": [{"hypothesis": {"class_id": name, "score": score}} for name, score in classes],
        "bbox": {
            "center": builders.pose((x, 2, 3), quaternion),
            "size": dict(zip("xyz", map(float, size), strict=True)),
        },
        "id": id_,
    }


def message(*detections: Fields) -> RawMessage:
    body = {"header": builders.header(STAMP_NS, "/site"), "detections": list(detections)}
    return builders.raw("/objects", MSGTYPE, body, STAMP_NS)


def decode(*detections: Fields) -> Detections3D:
    return decode_detections3d(message(*detections))


def test_counts_are_no_classes_and_scores_are_shares() -> None:
    found = decode(
        detection(("lidar_points", 700.0), ("van", 1.0), ("image_pixels/front", 12.0), id_="car1"),
        detection(("car", 0.25), ("bus", 0.75), ("truck", 0.75), ("car", math.nan), id_="x"),
        detection(("lidar_points", 0.0), ("lidar_points", math.inf)),
        detection(("car", 97.0)),
        detection(("car", -0.5)),
    )
    assert found.labels.tolist() == ["van", "bus", "", "car", "car"]
    assert found.ids.tolist() == ["car1", "x", "", "", ""]
    np.testing.assert_array_equal(found.scores, np.array([1.0, 0.75, 0.0, 1.0, 0.0], np.float32))
    np.testing.assert_array_equal(found.counts["lidar_points"], [700, np.nan, 0, np.nan, np.nan])
    np.testing.assert_array_equal(found.counts["image_pixels/front"], [12, *[np.nan] * 4])
    assert sorted(found.counts) == ["image_pixels/front", "lidar_points"]


def test_heading_of_a_turned_and_tilted_box() -> None:
    half = math.radians(130) / 2
    tilt = math.radians(8) / 2
    turned = (0, 0, math.sin(half), math.cos(half))
    # First tilted about its own y axis, then turned about z: the heading stays.
    tilted = (
        -math.sin(half) * math.sin(tilt),
        math.cos(half) * math.sin(tilt),
        math.sin(half) * math.cos(tilt),
        math.cos(half) * math.cos(tilt),
    )
    longer = tuple(3 * part for part in turned)
    opposite = (0, 0, 1, 0)
    found = decode(*(detection(("car", 1), quaternion=each) for each in (turned, tilted, longer, opposite)))
    np.testing.assert_allclose(np.degrees(found.yaws), [130, 130, 130, 180], atol=1e-9)


def test_boxes_that_cannot_be_used_are_counted() -> None:
    upright = math.sqrt(0.5)
    found = decode(
        detection(("car", 1), id_="sound"),
        detection(("car", 1), size=(4, 0, 2)),
        detection(("car", 1), size=(4, -1, 2)),
        detection(("car", 1), size=(4, math.inf, 2)),
        detection(("car", 1), x=math.nan),
        detection(("car", 1), x=1e300),
        detection(("car", 1), size=(1e300, 1, 2)),
        detection(("car", 1), quaternion=(0, 0, 0, 0)),
        detection(("car", 1), quaternion=(0, 0, 0, math.nan)),
        detection(("car", 1), quaternion=(0, upright, 0, upright)),  # its length points up
        detection(("car", 1), quaternion=(0, 0, 1e300, 0)),
    )
    assert found.ids.tolist() == ["sound"]
    assert dict(found.unused) == {"box without a heading": 4, "box without a volume or not finite": 6}


# --- ids as numbers


def test_numbers_are_themselves_and_names_have_numbers_of_their_own() -> None:
    names = np.array(["7", "", "car1", "007", "car2", "car1", "999999999999999999", "9999999999999999999", "²", "-3"])
    found = track_ids(names)
    assert found.dtype == np.int64
    assert found[[0, 1, 3, 6]].tolist() == [7, UNKNOWN, 7, 999999999999999999]
    of_names = found[[2, 4, 7, 8, 9]]
    assert (of_names >= 1 << 62).all()
    assert len({*of_names.tolist()}) == 5
    assert found[2] == found[5]
    assert track_ids(names[[2]])[0] == found[2]  # whatever else was met before
    assert track_ids(names[:0]).shape == (0,)
