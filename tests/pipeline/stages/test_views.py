from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import camera_rig, forward_camera
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.combine import MotionConfig
from lidcam.pipeline.stages.views import Views

MS = 1_000_000
STAMP_NS = 1_600_000_000_000_000_000
RIG = camera_rig(forward_camera("a"), replace(forward_camera("b"), boxes_topic="/b/boxes"))


def pose(time_s: float, speed_m_s: float = 20.0, yaw_rate: float = 0.0) -> F64:
    """A site that drives along its own x axis and turns, somewhere on a map."""
    turn = Rotation.from_euler("z", 0.4 + yaw_rate * time_s).as_matrix()
    return pose_matrix(turn, [5000.0, -300.0, 40.0] + turn[:, 0] * speed_m_s * time_s)


def motion(*times_ms: float, speed_m_s: float = 20.0, yaw_rate: float = 0.0) -> PoseSamples:
    stamps_ns = STAMP_NS + np.array([round(ms * MS) for ms in times_ms], np.int64)
    poses = np.array([pose(ms / 1e3, speed_m_s, yaw_rate) for ms in times_ms]).reshape(-1, 4, 4)
    return PoseSamples("site", "map", stamps_ns, poses)


def views(
    late_ms: Mapping[str, float], known: PoseSamples | None, rig: Rig = RIG, **settings: Any
) -> Mapping[str, Any]:
    messages = {
        topic: RawMessage(STAMP_NS + round(ms * MS), 0, (0, 0), b"", Channel(topic, "sensor_msgs/msg/Image", "cdr"))
        for topic, ms in late_ms.items()
    }
    bundle = SensorBundle(0, STAMP_NS, 0, messages, known)
    return Views(rig, MotionConfig.model_validate(settings))(bundle)


def test_a_late_image_was_taken_further_on() -> None:
    found = views({"/a/image": 50, "/b/image": 0}, motion(-100, 0, 100))
    assert [*found] == ["a", "b"]
    assert found["b"] is RIG.cameras[1]
    np.testing.assert_allclose(found["a"].T_camera_site.inverse().translation, [1.0, 0, 0], atol=1e-6)
    assert (found["a"].T_camera_site.dst, found["a"].T_camera_site.src) == ("a", "site")
    assert found["a"].model is RIG.cameras[0].model


def test_recorded_boxes_count_before_the_image() -> None:
    found = views({"/b/image": 0, "/b/boxes": -25}, motion(-100, 0, 100))
    np.testing.assert_allclose(found["b"].T_camera_site.inverse().translation, [-0.5, 0, 0], atol=1e-6)
    assert found["a"] is RIG.cameras[0], "it has no message"


@given(st.floats(-90, 90), st.floats(-1, 1), st.floats(-30, 30))
def test_what_stands_still_on_the_map_is_projected_to_where_it_was_seen(
    late_ms: float, yaw_rate: float, speed_m_s: float
) -> None:
    late_ms = round(late_ms)
    known = motion(*np.arange(-100.0, 101.0, 1.0), speed_m_s=speed_m_s, yaw_rate=yaw_rate)
    camera: CameraSensor = views({"/a/image": late_ms}, known)["a"]
    on_map = np.array([[5020.0, -290.0, 41.0], [5030.0, -289.0, 40.0]])

    def in_site(time_s: float) -> F64:
        T = np.linalg.inv(pose(time_s, speed_m_s, yaw_rate))
        return np.asarray(on_map @ T[:3, :3].T + T[:3, 3])

    truth = RIG.cameras[0].T_camera_site.apply(in_site(late_ms / 1e3))
    np.testing.assert_allclose(camera.T_camera_site.apply(in_site(0.0)), truth, atol=1e-6)


@pytest.mark.parametrize(
    ("known", "settings"),
    [
        (None, {}),
        (motion(0), {}),
        (motion(-100, 0, 100), {"enabled": False}),
        (motion(-2000, 0, 2000), {}),
        (motion(-400, -260), {}),
        (motion(-100, 0, 100, speed_m_s=0.0), {}),
    ],
    ids=["no odometry", "one pose", "off", "a gap", "old odometry", "standing"],
)
def test_without_known_motion_cameras_are_those_of_the_rig(known: PoseSamples | None, settings: dict[str, Any]) -> None:
    found = views({"/a/image": 50, "/b/image": -50}, known, **settings)
    assert all(found[camera.name] is camera for camera in RIG.cameras)
