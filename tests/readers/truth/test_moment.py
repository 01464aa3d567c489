from dataclasses import replace

import numpy as np
import pytest
from detections import forward_camera
from evaluation_frames import truth_boxes
from truth_messages import true_object, truth_message

from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes3D
from lidcam.readers.messages.detections import decode_detections3d, track_ids
from lidcam.readers.truth.moment import Moment, counted, moment_of, projected_truth, total

CONFIG = Config()
CLASSES = CONFIG.class_id_of_label
NAMES = CONFIG.class_names
STAMP_NS = 1_700_000_000_000_000_000


def found(*objects: dict[str, object], **options: object) -> Moment:
    return moment_of(decode_detections3d(truth_message(STAMP_NS, objects, **options)), CLASSES)  # type: ignore[arg-type]  # as given


def test_objects_of_ros2() -> None:
    moment = found(
        true_object("van", (1, 2, 0.5), yaw=1.0, name="van_1", counts={"lidar_points": 12, "image_pixels": 900}),
        true_object("Cyclist", (3, 4, 0.5), name="7", counts={"image_pixels/left": 5, "lidar_points/top": 0}),
        true_object("tram", (5, 6, 0.5)),
        frame_id="/odom",
    )
    boxes = moment.boxes
    assert (moment.stamp_ns, boxes.frame_id) == (STAMP_NS, "odom")
    assert [NAMES[row] if row != UNKNOWN else "" for row in boxes.class_ids] == ["truck", "bicycle", ""]
    assert boxes.labels.tolist() == ["van", "Cyclist", "tram"]
    assert boxes.track_ids.tolist() == [int(track_ids(np.array(["van_1"]))[0]), 7, UNKNOWN]
    assert boxes.lidar_points.tolist() == [12, UNKNOWN, UNKNOWN]
    assert boxes.image_pixels.tolist() == [900, UNKNOWN, UNKNOWN]
    assert [*moment.camera_pixels] == ["left"]
    assert moment.camera_pixels["left"].tolist() == [UNKNOWN, 5, UNKNOWN]
    assert not boxes.is_ignored.any()
    np.testing.assert_allclose(boxes.yaws, [1, 0, 0])


def test_counts_and_the_total_of_the_sensors() -> None:
    values = np.array([0.0, 12.4, np.nan, np.inf, -5.0, 1e20])
    assert counted(values).tolist() == [0, 12, UNKNOWN, UNKNOWN, UNKNOWN, 2**31 - 1]
    counts = {"lidar_points/a": np.array([1.0, np.nan, np.nan]), "lidar_points/b": np.array([2.0, 3.0, np.nan])}
    assert total(counts, "lidar_points", 3).tolist() == [3, 3, UNKNOWN]
    assert total({**counts, "lidar_points": np.array([9.0, 9, 9])}, "lidar_points", 3).tolist() == [9, 9, 9]


# --- objects as a camera sees them

CAMERA: CameraSensor = forward_camera("left")


def boxes(*pixels: int) -> TruthBoxes3D:
    """Four objects: two ahead of the camera, one beside its image, one behind it."""
    places = [(10.0, 0), (20, 1), (5, 60), (-10, 0)]
    found = truth_boxes(
        [(x, y, 0, 2, 1, 1, 0) for x, y in places],
        [1, 2, 3, 4],
        class_ids=[0, 3, 0, 0],
        labels=["car", "van", "car", "car"],
        image_pixels=pixels or None,
        is_ignored=[False, True, False, False],
    )
    return replace(found, stamp_ns=7)


def test_objects_ahead_are_seen_where_they_are_projected() -> None:
    shown = projected_truth(boxes(), CAMERA, None)
    assert shown.stamp_ns == 7
    assert shown.track_ids.tolist() == [1, 2]
    assert shown.labels.tolist() == ["car", "van"]
    assert shown.class_ids.tolist() == [0, 3]
    assert shown.image_pixels.tolist() == [UNKNOWN, UNKNOWN]
    assert shown.is_ignored.tolist() == [False, True]
    corners = np.array([[9.0, y, z] for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    pixels, _ = CAMERA.model.project(CAMERA.T_camera_site.apply(corners))
    np.testing.assert_allclose(shown.xyxy[0], [*pixels.min(0), *pixels.max(0)], atol=1e-3)
    assert projected_truth(boxes().select(np.zeros(4, np.bool_)), CAMERA, None).xyxy.shape == (0, 4)


@pytest.mark.parametrize(
    ("overall", "of_image", "ids", "pixels"),
    [
        ((5, 0, 5, 5), None, [1], [UNKNOWN]),
        ((UNKNOWN, 0, 5, 5), None, [1], [UNKNOWN]),
        ((5, 5, 5, 5), [0, 3, 3, 3], [2], [3]),
        ((5, 5, 5, 5), [4, UNKNOWN, 3, 3], [1, 2], [4, UNKNOWN]),
        ((5, 0, 5, 5), [4, UNKNOWN, 3, 3], [1], [4]),
    ],
)
def test_hidden_objects_are_left_out(
    overall: tuple[int, ...], of_image: list[int] | None, ids: list[int], pixels: list[int]
) -> None:
    counts = None if of_image is None else np.array(of_image, np.int32)
    shown = projected_truth(boxes(*overall), CAMERA, counts)
    assert shown.track_ids.tolist() == ids
    assert shown.image_pixels.tolist() == pixels
