"""The sample recording is the one that its README describes, and its script still records it."""

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from bags.raycast import cast
from bags.record_sandbox import record
from bags.sandbox_world import CAMERAS, CARS, LIDARS, camera_pose, lidar_pose
from pipeline.geometry import rotation_fault

ROOT = Path(__file__).resolve().parents[1]


def test_readme_tells_size_and_hash() -> None:
    data = (ROOT / "bags" / "sandbox.bag").read_bytes()
    readme = (ROOT / "bags" / "README.md").read_text(encoding="utf-8")
    assert f"{len(data)} bytes" in readme
    assert hashlib.sha256(data).hexdigest() in readme
    assert len(data) <= 10 * 2**20


def test_same_seed_same_recording(tmp_path: Path) -> None:
    for name in ("a.bag", "b.bag"):
        record(tmp_path / name, seconds=0.1, seed=3)
    record(tmp_path / "c.bag", seconds=0.1, seed=4)
    a, b, c = ((tmp_path / name).read_bytes() for name in ("a.bag", "b.bag", "c.bag"))
    assert a == b != c


def test_topics_are_the_originals(tmp_path: Path) -> None:
    record(tmp_path / "a.bag", seconds=0.2, seed=1)
    with AnyReader([tmp_path / "a.bag"]) as reader:
        topics = {c.topic: c.msgtype for c in reader.connections}
        counts = {c.topic: c.msgcount for c in reader.connections}
    for name in ("11", "12", "13", "14", "41", "42", "43", "44"):
        assert topics[f"/image_raw_{name}/compressed"] == "sensor_msgs/msg/CompressedImage"
        assert counts[f"/image_raw_{name}/compressed"] == 2
    for number in (1, 2, 3):
        assert topics[f"/velodyne{number}_points"] == "sensor_msgs/msg/PointCloud2"
    assert re.fullmatch(r"nav_msgs/msg/Odometry", topics["/car1/base_pose_ground_truth"])


@pytest.mark.parametrize("name", [*LIDARS, *CAMERAS])
def test_every_pose_is_sound(name: str) -> None:
    pose = lidar_pose(name) if name in LIDARS else camera_pose(name)
    assert rotation_fault(pose.matrix[:3, :3]) is None


def test_cameras_look_where_the_original_says() -> None:
    for name, direction in {"11": (0, 1), "13": (-1, 0), "14": (1, 0), "41": (0, -1), "44": (-1, 0)}.items():
        forward = camera_pose(name).matrix[:2, 2]
        np.testing.assert_allclose(forward / np.linalg.norm(forward), direction, atol=1e-12)


def test_a_car_on_a_circle_keeps_its_distance_from_the_middle() -> None:
    center, yaw = CARS["car2"].pose(np.linspace(0, 3, 50))
    radius = CARS["car2"].speed_m_s / CARS["car2"].turn_rad_s
    np.testing.assert_allclose(np.hypot(center[:, 0] - 0.95 + radius, center[:, 1] + 3.0), radius, rtol=1e-12)
    assert np.all(np.diff(yaw) > 0)


@given(st.floats(-3, 3), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_a_ray_meets_the_face_it_is_aimed_at(yaw: float, across: float, up: float) -> None:
    size = np.array([2.0, 1.0, 1.0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    target = np.array([cos - across * sin, sin + across * cos, up])  # on the front face (local x = 1)
    origin = np.array([5 * cos, 5 * sin, 0.0])
    direction = (target - origin) / np.linalg.norm(target - origin)
    distance, normal = cast(origin, direction[None], np.zeros(3), size, yaw)
    np.testing.assert_allclose(distance, np.linalg.norm(target - origin), rtol=1e-9)
    np.testing.assert_allclose(normal[0], [cos, sin, 0], atol=1e-9)


def test_rays_that_miss_start_inside_or_point_away_hit_nothing() -> None:
    size = np.ones(3)
    rays = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 0, 1.0]])
    origins = np.array([[-3.0, 2, 0], [-3.0, 0, 0], [0.0, 0, 0]])
    distance, _ = cast(origins, rays, np.zeros(3), size, 0.0)
    assert np.isinf(distance).all()
