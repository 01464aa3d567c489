from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import LOOK_FORWARD, boxes3d, forward_camera
from frames import frame
from hypothesis import given
from hypothesis import strategies as st
from lidar_scene import combined

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.rotations import matrix_of_rpy, pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.writers.viewpoint import SURVEYED_FRAMES, SceneSurvey, Viewpoint, cameras_in_order, front_of_rig

ASPECT, FOV_Y_DEG = 1.3, 55.0


def camera(name: str, azimuth_deg: float, place: tuple[float, float, float] = (0, 0, 1.5)) -> CameraSensor:
    turned = pose_matrix(matrix_of_rpy((0.0, 0.0, np.radians(azimuth_deg))), place)
    return replace(forward_camera(name), T_camera_site=Transform(name, "site", LOOK_FORWARD @ np.linalg.inv(turned)))


def lidar(x: float, y: float, z: float = 2.0) -> LidarSensor:
    return LidarSensor(f"l{x}{y}", "/l", Transform.from_quaternion("site", "l", (x, y, z), (0, 0, 0, 1)))


def rig(*cameras: CameraSensor, lidars: tuple[LidarSensor, ...] = (lidar(0, 0),)) -> Rig:
    return Rig("site", lidars, cameras, ())


def cloud(xy: Any) -> CombinedCloud:
    return combined(np.column_stack([np.reshape(xy, (-1, 2)), np.zeros(len(xy))]))


def seen(places: Any, *, points: Any = (), score: float = 0.9) -> FrameResult:
    """A frame with cars at places x, y and with points."""
    rows = [[x, y, 0.8, 4.0, 1.8, 1.6, 0.2] for x, y in places]
    found = boxes3d(rows, scores=[score] * len(rows))
    fused = Fused(found, np.zeros(len(rows), np.int32), np.arange(len(rows), dtype=np.int64))
    return replace(frame(), fused=fused, combined=cloud(points))


def ring(radius_m: float) -> F64:
    angle = np.linspace(0, 2 * np.pi, 200)
    return np.stack([np.cos(angle), np.sin(angle)], -1) * radius_m


def place_eye(of: Rig, *frames: FrameResult) -> Viewpoint:
    survey = SceneSurvey(of)
    for one in frames:
        survey.add_frame(one)
    return survey.viewpoint(aspect=ASPECT, fov_y_deg=FOV_Y_DEG)


def in_view(view: Viewpoint, points: Any) -> Any:
    """Which points are in view: as a viewer projects them, with z up."""
    ahead = (view.target - view.eye) / np.linalg.norm(view.target - view.eye)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    away = np.asarray(points, np.float64) - view.eye
    depth, slope = away @ ahead, np.tan(np.radians(FOV_Y_DEG) / 2)
    across, up = away @ right, away @ np.cross(right, ahead)
    return (depth > 0) & (np.abs(across) <= slope * ASPECT * depth) & (np.abs(up) <= slope * depth)


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0, -45.0])
def test_a_rig_that_looks_one_way_is_seen_from_behind(azimuth_deg: float) -> None:
    front = np.array([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))])
    places = np.array([10 * front, 16 * front + 4 * front[::-1]])
    view = place_eye(rig(camera("c", azimuth_deg)), seen(places, points=ring(20)))
    assert view.eye[:2] @ front < 0
    assert view.eye[2] > 2
    along = (view.target - view.eye)[:2]
    np.testing.assert_allclose(along / np.linalg.norm(along), front, atol=1e-9)
    assert in_view(view, [[x, y, 0.8] for x, y in places]).all()
    assert in_view(view, [[0, 0, 2]]).all()


@given(st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10)), max_size=6), st.floats(8, 30), st.floats(-180, 180))
def test_sensors_around_a_scene_are_in_view_with_all_of_its_objects(
    places: list[tuple[float, float]], radius_m: float, azimuth_deg: float
) -> None:
    around = [(azimuth_deg + turn, ring(radius_m)[turn // 2]) for turn in (0, 90, 180, 270)]
    cameras = [camera(f"c{turn}", turn, (x, y, 5)) for turn, (x, y) in around]
    view = place_eye(rig(*cameras, lidars=(lidar(radius_m, 0), lidar(-radius_m, 0))), seen(places, points=ring(20)))
    assert in_view(view, [[x, y, 0.8] for x, y in places] + [[x, y, 5] for _, (x, y) in around]).all()


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, -45.0])
def test_from_above_the_same_is_in_view_and_all_objects(azimuth_deg: float) -> None:
    survey = SceneSurvey(rig(camera("c", azimuth_deg)))
    turn = matrix_of_rpy((0.0, 0.0, np.radians(azimuth_deg)))[:2, :2].T
    places, behind = np.array([[10, 3], [30, -2]]) @ turn, np.array([[-40, 5]]) @ turn
    for _ in range(SURVEYED_FRAMES):
        survey.add_frame(seen(places, points=ring(20)))
    survey.add_frame(seen(behind, points=ring(20)))
    places = np.concatenate([places, behind])
    of = survey.viewpoint(aspect=ASPECT, fov_y_deg=FOV_Y_DEG)
    for aspect in (0.5, 3.0):
        above = survey.above(of, aspect=aspect, fov_y_deg=FOV_Y_DEG)
        np.testing.assert_allclose(above.eye[:2], above.target[:2], atol=1e-9)
        along = of.up @ above.up
        assert along == pytest.approx(1.0 if aspect < 1 else 0.0)  # what is long lies along the view
        away, height = places - above.eye[:2], above.eye[2]
        right = np.array([above.up[1], -above.up[0]])
        slope = np.tan(np.radians(FOV_Y_DEG) / 2)
        assert (np.abs(away @ above.up) <= slope * height).all()
        assert (np.abs(away @ right) <= slope * aspect * height).all()


@pytest.mark.parametrize("heights", [[], [-1.5], [-1.6, -1.5, -1.4]])
def test_the_ground_is_where_its_points_are(heights: list[float]) -> None:
    survey = SceneSurvey(replace(rig(), ground_height_m=-2.0))
    for height in heights:
        one = cloud(ring(20))
        ground = replace(one.cloud, xyz=one.cloud.xyz + np.array([0, 0, height], np.float32))
        survey.add_frame(replace(seen([]), combined=replace(one, ground_cloud=ground)))
    assert survey.ground_m == pytest.approx(-1.5 if heights else -2.0)


def test_what_lies_far_off_or_behind_a_vehicle_does_not_pull_the_eye_back() -> None:
    near = place_eye(rig(camera("c", 0)), seen([(10, 0)], points=ring(20)))
    same = place_eye(rig(camera("c", 0)), seen([(10, 0), (-30, 5), (400, 0)], points=ring(20)))
    np.testing.assert_allclose(same.eye, near.eye)


def test_doubtful_objects_count_only_where_there_are_no_others() -> None:
    around, sure = rig(lidars=(lidar(10, 0), lidar(-10, 0))), seen([(5, 5)], points=ring(20))
    doubtful = seen([(0, 22), (0, -22)], points=ring(20), score=0.2)
    np.testing.assert_allclose(place_eye(around, sure, doubtful).eye, place_eye(around, sure, sure).eye)
    assert in_view(place_eye(around, doubtful), [[0, 22, 0.8], [0, -22, 0.8]]).all()


AROUND = {"front": 0, "front_left": 55, "front_right": -55, "rear": 180, "rear_left": 110, "rear_right": -110}


@pytest.mark.parametrize("turned_deg", [0.0, 90.0])
def test_cameras_are_shown_as_they_look_around(turned_deg: float) -> None:
    of = rig(*[camera(f"CAM_{name.upper()}", azimuth + turned_deg) for name, azimuth in AROUND.items()])
    expected = ["FRONT_LEFT", "FRONT", "FRONT_RIGHT", "REAR_LEFT", "REAR", "REAR_RIGHT"]
    assert [one.name.removeprefix("CAM_") for one in cameras_in_order(of)] == expected
    angle = np.radians(turned_deg)
    np.testing.assert_allclose(front_of_rig(of), [np.cos(angle), np.sin(angle)], atol=1e-9)


def test_frames_without_points_and_objects_are_not_among_the_first() -> None:
    of, shown = rig(camera("front", 0)), seen([(20, 1)], points=ring(30))
    late = place_eye(of, *[seen([])] * (SURVEYED_FRAMES + 2), *[shown] * SURVEYED_FRAMES)
    np.testing.assert_array_equal(late.eye, place_eye(of, *[shown] * SURVEYED_FRAMES).eye)


def test_boxes_without_any_sensor_are_in_view() -> None:
    view = place_eye(rig(lidars=()), seen([(8, 3), (12, -2)]))
    assert in_view(view, [[8, 3, 0.8], [12, -2, 0.8]]).all()
