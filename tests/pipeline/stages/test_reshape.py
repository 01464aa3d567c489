"""Boxes completed again with the class that the cameras give."""

from dataclasses import replace

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan

from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, Hypotheses
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.stages.detect3d import Detect3D
from lidcam.pipeline.stages.reshape import Reshape

LIDAR = (0.0, 0.0, 1.8)
CAR, PEDESTRIAN, BICYCLE, TRUCK, BUS = range(5)
REAR: Box = (12.0, 0.0, 0.75, 0.3, 1.8, 1.5, 0.0)
RIDER: Box = (8.0, 4.0, 0.95, 0.7, 0.4, 1.5, 1.0)
GEOMETRIC = load_config(settings=("detect3d.score=geometric",))
FIELDS = Boxes3D.__slots__


def found(*scene: Box) -> tuple[CombinedCloud, Boxes3D]:
    cloud = combined(scan(LIDAR, [*scene]))
    boxes = Detect3D(rig(LIDAR), GEOMETRIC)(cloud)
    assert len(boxes) == len(scene)
    return cloud, boxes


def reshaped(
    cloud: CombinedCloud, lidar: Boxes3D, class_ids: list[int], *, proposed: Boxes3D | None = None, config: Config
) -> Boxes3D:
    """The boxes after a change of their classes."""
    boxes = lidar if proposed is None else lidar.joined(proposed)
    hypotheses = Hypotheses(replace(boxes, class_ids=np.array(class_ids, np.int32)), {}, len(lidar))
    fitter = BoxFitter(rig(LIDAR), config.classes, config.detect3d.cluster)
    result = Reshape(fitter, config.detect3d, config.classes)(cloud, hypotheses, lidar)
    assert (result.lidar_count, result.matches) == (hypotheses.lidar_count, {})
    return result.boxes


def assert_unchanged(boxes: Boxes3D, before: Boxes3D, row: int, *, but: tuple[str, ...] = ("class_ids",)) -> None:
    for name in set(FIELDS) - {"stamp_ns", "frame_id", *but}:
        np.testing.assert_array_equal(getattr(boxes, name)[row], getattr(before, name)[row], err_msg=name)


def test_rear_of_a_car_becomes_that_of_a_van() -> None:
    cloud, lidar = found(REAR)
    assert lidar.class_ids.tolist() == [CAR]
    boxes = reshaped(cloud, lidar, [TRUCK], config=Config())
    length_m = Config().classes[TRUCK].kinds_m[0][0]
    assert boxes.class_ids.tolist() == [TRUCK]
    assert boxes.sizes[0, 0] == pytest.approx(length_m)
    assert boxes.centers[0, 0] - length_m / 2 == pytest.approx(lidar.centers[0, 0] - lidar.sizes[0, 0] / 2, abs=0.02)
    assert boxes.centers[0, 2] == pytest.approx(boxes.sizes[0, 2] / 2)
    assert boxes.covariances[0, 0, 0] > lidar.covariances[0, 0, 0]
    assert_unchanged(boxes, lidar, 0, but=("class_ids", "centers", "sizes", "yaws", "covariances"))


def test_a_pedestrian_that_is_a_cyclist_gets_a_length_about_its_middle() -> None:
    cloud, lidar = found(RIDER)
    boxes = reshaped(cloud, lidar, [BICYCLE], config=Config())
    assert boxes.sizes[0, :2] == pytest.approx(Config().classes[BICYCLE].size_m[:2], abs=0.1)
    assert boxes.centers[0, :2] == pytest.approx(RIDER[:2], abs=0.15)


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_of_both_directions_the_one_nearer_to_the_old_is_kept(turn: float) -> None:
    cloud, lidar = found(REAR)
    lidar = replace(lidar, yaws=np.where(lidar.yaws + turn > np.pi, lidar.yaws - turn, lidar.yaws + turn))
    boxes = reshaped(cloud, lidar, [TRUCK], config=Config())
    assert np.cos(boxes.yaws[0] - lidar.yaws[0]) > 0.99


def test_boxes_of_an_unchanged_class_or_proposed_from_a_camera_stay() -> None:
    cloud, lidar = found(REAR, RIDER)
    proposed = replace(lidar.select(np.array([0])), class_ids=np.array([BUS], np.int32))
    rows = lidar.class_ids.tolist()
    boxes = reshaped(cloud, lidar, [*rows, TRUCK], proposed=proposed, config=Config())
    for row in range(3):
        assert_unchanged(boxes, lidar.joined(proposed), row)
    changed = [TRUCK if class_id == CAR else class_id for class_id in rows]
    boxes = reshaped(cloud, lidar, [*changed, TRUCK], proposed=proposed, config=Config())
    assert_unchanged(boxes, lidar, rows.index(PEDESTRIAN))


def test_a_box_too_large_for_the_class_or_without_points_stays_and_so_does_its_class() -> None:
    cloud, lidar = found(REAR, RIDER)
    boxes = reshaped(cloud, lidar, [PEDESTRIAN, PEDESTRIAN], config=Config())
    assert_unchanged(boxes, lidar, lidar.class_ids.tolist().index(CAR), but=())
    away = replace(lidar, centers=lidar.centers + 100.0)
    boxes = reshaped(cloud, away, [TRUCK, BUS], config=Config())
    for row in range(2):
        assert_unchanged(boxes, away, row, but=())
