"""What the cameras alone make in 3D."""

from collections.abc import Mapping

import numpy as np
import pytest
from detections import boxes2d, camera_rig
from fusion_stages import associate_of, place_of
from helpers import shared
from lidar_scene import combined
from seen_boxes import Box, camera_at, seen_by, views_of

from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.clouds import CombinedCloud, Plane, PointCloud
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Hypotheses, Source
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.fusion.projection import CameraArrays, project_edges, rounded_outline
from lidcam.pipeline.stages.combine import Combine
from lidcam.pipeline.stages.place import Place
from lidcam.pipeline.stages.refine import Refine
from lidcam.readers.rig.importers import kitti_calibration
from lidcam.readers.truth.kitti import LEFT_COLOUR_CAMERA, parse_kitti_labels

CONFIG = Config()
CAR, PEDESTRIAN = 0, 1
WEST = camera_at("west", (-20.0, 0.0, 5.0), pitch_deg=10)
NORTH = camera_at("north", (0.0, 20.0, 5.0), yaw_deg=-90, pitch_deg=10)
CARS: list[Box] = [(2.0, 3.0, 0.775, 4.0, 1.7, 1.55, 0.4), (-3.0, -4.0, 0.775, 4.0, 1.7, 1.55, 1.5)]
EMPTY = combined(np.zeros((0, 3)))


def place(boxes: Mapping[str, Boxes2D], *cameras: CameraSensor, cloud: CombinedCloud = EMPTY) -> Boxes3D:
    return place_of(camera_rig(*cameras))(cloud, boxes, views_of(*cameras)).boxes


def test_objects_of_two_cameras_are_merged_and_placed() -> None:
    found = place({c.name: seen_by(c, CARS, [CAR, CAR]) for c in (WEST, NORTH)}, WEST, NORTH)
    assert len(found) == 2
    order = np.argsort(-found.centers[:, 0])
    np.testing.assert_allclose(found.centers[order], np.array(CARS)[:, :3], atol=0.5)
    assert found.sources.tolist() == [Source.CAMERA] * 2
    assert found.scores == pytest.approx([1 - 0.2 * 0.2] * 2)
    assert found.point_counts.tolist() == [0, 0]
    assert found.sizes.tolist() == [[4.0, 1.7, 1.55]] * 2
    assert (found.stamp_ns, found.frame_id) == (7, "site")


def test_time_is_the_mean_of_the_images() -> None:
    boxes = {c.name: seen_by(c, CARS[:1], [CAR]) for c in (WEST, NORTH)}
    boxes["west"] = Boxes2D(10**18 + 20, "west", boxes["west"].xyxy, boxes["west"].scores, boxes["west"].class_ids)
    boxes["north"] = Boxes2D(10**18 + 30, "north", boxes["north"].xyxy, boxes["north"].scores, boxes["north"].class_ids)
    assert place(boxes, WEST, NORTH).measured_ns.tolist() == [10**18 + 25]


def test_boxes_stand_on_the_ground_of_the_frame() -> None:
    slope = Plane(np.array([-0.1, 0.0, 1.0]) / np.hypot(0.1, 1), 0.0)
    box = (10.0, 0.0, 1.0 + 0.775, 4.0, 1.7, 1.55, 0.0)
    cloud = combined(np.zeros((0, 3)), plane=slope)
    found = place({"west": seen_by(WEST, [box], [CAR])}, WEST, cloud=cloud)
    assert found.centers[0, 2] == pytest.approx(0.1 * found.centers[0, 0] + 0.775)
    assert found.centers[0, 0] == pytest.approx(10.0, abs=1.5)


def test_refined_placements_say_how_near_they_are() -> None:
    # The 2D boxes that placed an object refine it, and are no second evidence of its direction.
    random, squared = np.random.default_rng(0), list[float]()
    camera = camera_at("cam", (0.0, 0.3, 1.6))
    rig, views, arrays = camera_rig(camera), views_of(camera), CameraArrays.of([camera])
    for _ in range(80):
        size = np.array([CONFIG.classes[CAR].size_m]) * random.normal(1, [[0.13, 0.1, 0.1]]).clip(0.7, 1.4)
        x, yaw = random.uniform(12, 40), random.uniform(-np.pi, np.pi, 1)
        center = np.array([[x, random.uniform(-0.2, 0.2) * x, size[0, 2] / 2]])
        xyxy = project_edges(center, size, yaw, arrays, rounded_outline(size, bent=False)).xyxy[0]
        xyxy += random.normal(0, np.hypot(1.5, 0.04 * np.sqrt(np.prod(xyxy[2:] - xyxy[:2]))), 4)
        seen = {"cam": boxes2d([(*xyxy, 0.8, CAR)])}
        placed = place(seen, camera)
        hypotheses = Hypotheses(placed, associate_of(rig)(placed, seen, views), 0)
        found = Refine(rig, CONFIG.fuse)(hypotheses, seen, views).boxes
        gap = found.centers[0, :2] - center[0, :2]
        squared.append(gap @ np.linalg.solve(found.covariances[0, :2, :2], gap))
    assert np.mean(squared) < 3.0  # 2 is expected
    assert np.mean(np.array(squared) < 5.99) > 0.9


@pytest.mark.parametrize(("pitch_deg", "least"), [(60.0, 20), (75.0, 8), (85.0, 2), (89.9, 0)])
def test_a_camera_that_looks_down_places_what_is_not_around_the_point_below_it(pitch_deg: float, least: int) -> None:
    random, camera = np.random.default_rng(1), camera_at("cam", (0.0, 0.0, 7.0), pitch_deg=pitch_deg)
    cars = random.uniform([-2, -2, 0.775, 4, 1.7, 1.55, -3], [2, 2, 0.775, 4, 1.7, 1.55, 3], (20, 7))
    cars[:, 0] += 7 / np.tan(np.radians(pitch_deg))
    found = [place({"cam": seen_by(camera, [(*car.tolist(),)], [CAR])}, camera) for car in cars]
    far_m = [np.abs(one.centers[0, :2] - car[:2]).max() for one, car in zip(found, cars, strict=True) if len(one)]
    assert len(far_m) >= least
    assert max(far_m, default=0.0) < 2.0, "metres, not kilometres"


def test_no_cameras_and_no_boxes() -> None:
    assert len(place({})) == 0
    assert len(place({}, WEST)) == 0
    assert len(place({"west": Boxes2D.empty(1, "west")}, WEST)) == 0


# --- real frames: the labelled 2D boxes in the place of a network's


def kitti(name: str) -> tuple[Place, CombinedCloud, Boxes2D, CameraSensor, list[tuple[str, np.ndarray]]]:
    root = shared("data/kitti_object/training")
    path = root / "calib" / f"{name}.txt"
    calibration = kitti_calibration(path.read_text(), path)
    assert calibration is not None
    projection = calibration.projections[LEFT_COLOUR_CAMERA]
    K = projection[:, :3].copy()
    K[2] = 0, 0, 1
    T_camera_rect = np.eye(4)
    T_camera_rect[:3, 3] = np.linalg.solve(K, projection[:, 3])
    pose = Transform("cam", "velodyne", T_camera_rect @ calibration.T_rect_velo)
    camera = CameraSensor("cam", "/cam", "", CameraModel("cam", 1242, 375, K, "plumb_bob", np.zeros(0)), pose)
    lidar = LidarSensor("lidar", "/lidar", Transform.identity("velodyne", "velodyne"))
    rig = Rig("velodyne", (lidar,), (camera,), ())
    points = np.fromfile(root / "velodyne" / f"{name}.bin", np.float32).reshape(-1, 4)
    n = len(points)
    xyz, intensity = points[:, :3].copy(), points[:, 3].copy()
    cloud = PointCloud(1, "velodyne", xyz, intensity, np.zeros(n, np.uint16), np.zeros(n, np.int32))
    frame = Combine(rig, CONFIG.combine)(SensorBundle(0, 1, 1, {}), {"lidar": cloud})
    path = root / "label_2" / f"{name}.txt"
    ids = {"Car": CAR, "Pedestrian": PEDESTRIAN}
    labels = [one for one in parse_kitti_labels(path.read_text(), path).labels if one.label in ids]
    truth = [(one.label, (np.linalg.inv(calibration.T_rect_velo) @ one.T_rect_box())[:3, 3]) for one in labels]
    return place_of(rig), frame, boxes2d([(*one.xyxy, 0.9, ids[one.label]) for one in labels]), camera, truth


@pytest.mark.parametrize("name", ["000000", "000002", "000003"])
def test_labelled_boxes_of_real_frames_are_placed_within_two_metres(name: str) -> None:
    stage, frame, boxes, camera, truth = kitti(name)
    found = stage(frame, {"cam": boxes}, {"cam": camera})
    assert len(found.boxes) == len(truth)
    for row, object_of_row in zip(found.sightings.rows, found.objects, strict=True):
        gap = found.boxes.centers[object_of_row, :2] - truth[row][1][:2]
        covariance = found.boxes.covariances[object_of_row, :2, :2]
        assert np.hypot(*gap) < 2.0
        assert gap @ np.linalg.solve(covariance, gap) < 9.2
