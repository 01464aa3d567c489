from typing import Any

import numpy as np
import pytest
from builders import odometry, raw, tf_message, transform_stamped
from evaluation_frames import truth_boxes
from memory_recording import MemoryRecording
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.readers.truth.site import SitePoses, boxes_in_site

S = 10**9
STEP_NS = 100_000_000
RIG = Rig("base_link", (LidarSensor("top", "/points", Transform.identity("base_link", "base_link")),), (), ())


def turn(yaw: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))


def transform(parent: str, child: str, shift: tuple[float, float, float], yaw: float) -> Transform:
    return Transform.from_quaternion(parent, child, shift, turn(yaw))


def tf(stamp_ns: int, *edges: tuple[str, str, tuple[float, float, float], float], topic: str = "/tf") -> RawMessage:
    items = [
        transform_stamped(parent, child, stamp_ns=stamp_ns, translation=shift, rotation_xyzw=turn(yaw))
        for parent, child, shift, yaw in edges
    ]
    return raw(topic, "tf2_msgs/msg/TFMessage", tf_message(items), stamp_ns)


def pose(stamp_ns: int) -> Transform:
    """Where base_link is in odom: it drives 10 m/s along a curve."""
    t = stamp_ns / 1e9
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("z", 0.3 * t).as_matrix()
    matrix[:3, 3] = [10 * t, t * t, 0.2]
    return Transform("odom", "base_link", matrix)


def drive(until: int = 20, *, over: str = "odom") -> list[RawMessage]:
    at = [(number * STEP_NS, number * STEP_NS / 1e9) for number in range(until)]
    return [tf(stamp_ns, (over, "base_link", (10 * t, t * t, 0.2), 0.3 * t)) for stamp_ns, t in at]


def poses(*recordings: list[RawMessage], config: Config | None = None) -> SitePoses:
    return SitePoses([MemoryRecording(messages) for messages in recordings], RIG, config or Config())


def T_site(site: SitePoses, frame_id: str, stamp_ns: int) -> Transform:
    found = site.T_site_frame(frame_id, stamp_ns)
    assert found is not None
    assert (found.dst, found.src) == ("base_link", frame_id or "base_link")
    return found


def assert_pose(site: SitePoses, stamp_ns: int, *, atol: float = 1e-9) -> None:
    found = T_site(site, "odom", stamp_ns)
    np.testing.assert_allclose(found.matrix, pose(stamp_ns).inverse().matrix, atol=atol)


def test_frame_of_the_site_itself() -> None:
    for frame_id in ("base_link", ""):
        np.testing.assert_array_equal(T_site(poses([]), frame_id, 5).matrix, np.eye(4))


def test_a_site_that_moves() -> None:
    site = poses(drive())
    for stamp_ns in (0, STEP_NS, 8 * STEP_NS, 19 * STEP_NS):
        assert_pose(site, stamp_ns)
    between = poses(drive())
    assert_pose(between, 550_000_000, atol=0.01)
    assert_pose(between, 450_000_000, atol=0.01)  # images step back a little


def test_beyond_the_poses_and_in_a_gap() -> None:
    site = poses(drive(3))
    assert_pose(site, 2 * STEP_NS + 50_000_000, atol=0.02)
    assert site.T_site_frame("odom", 2 * STEP_NS + 250_000_000) is None
    gap = poses([*drive(3), tf(10 * S, ("odom", "base_link", (0, 0, 0), 0))])
    assert gap.T_site_frame("odom", 5 * S) is None
    assert poses(drive(1)).T_site_frame("odom", 0) is None


def test_a_chain_of_fixed_and_moving_frames() -> None:
    """map <- world (fixed) <- odom <- chassis (moving) <- base_link (fixed)."""
    fixed: Any = [
        ("map", "world", (0, 0, 7), 0),
        ("world", "odom", (0, 0, 1), 1.0),
        ("chassis", "base_link", (0.5, 0, 0), 0),
    ]
    map_world, world_odom, chassis_base = (transform(*edge) for edge in fixed)
    moving = [tf(n * STEP_NS, ("odom", "chassis", (float(n), 0, 0), 0)) for n in range(5)]
    expected = map_world @ world_odom @ transform("odom", "chassis", (2, 0, 0), 0) @ chassis_base
    found = T_site(poses([tf(0, *fixed, topic="/tf_static"), *moving]), "map", 2 * STEP_NS)
    np.testing.assert_allclose(found.matrix, expected.inverse().matrix, atol=1e-9)


def states(until: int = 20) -> list[RawMessage]:
    found = []
    for stamp_ns in range(0, until * STEP_NS, STEP_NS):
        frames, at = {"frame_id": "odom", "child_frame_id": "base_link"}, pose(stamp_ns)
        where = {"position": tuple(at.translation), "orientation_xyzw": tuple(at.quaternion_xyzw)}
        fields = odometry(stamp_ns=stamp_ns, **frames, **where)  # type: ignore[arg-type]  # as named
        found.append(raw("/odom", "nav_msgs/msg/Odometry", fields, stamp_ns))
    return found


def test_motion_by_odometry() -> None:
    site = poses(states())
    assert_pose(site, 7 * STEP_NS)
    static = tf(0, ("map", "odom", (1, 0, 0), 0), topic="/tf_static")
    found = T_site(poses([static, *states()]), "map", 7 * STEP_NS)
    expected = transform("map", "odom", (1, 0, 0), 0) @ pose(7 * STEP_NS)
    np.testing.assert_allclose(found.matrix, expected.inverse().matrix, atol=1e-9)


CIRCLE = [tf(n, ("a", "base_link", (n, 0, 0), 0), ("base_link", "a", (n, 0, 0), 0)) for n in range(3)]


@pytest.mark.parametrize(
    ("messages", "settings", "found"),
    [
        ([], [], "found none"),
        ([], ["combine.motion.topic=/odom"], "found none"),
        (drive(over="world"), [], "found those of base_link"),
        (states(), [], "found none"),
        ([tf(0, ("a", "b", (0, 0, 0), 0), topic="/tf_static")], [], "found those of a, b"),
        (CIRCLE, [], "found those of"),
    ],
)
def test_frames_that_nothing_joins(messages: list[RawMessage], settings: list[str], found: str) -> None:
    site = poses(messages, config=load_config(settings=settings))
    for _ in range(2):
        with pytest.raises(FrameError, match=f"join the truth's frame 'map' with the site frame 'base_link', {found}"):
            site.T_site_frame("map", 0)


def test_where_the_site_stands_on_the_ground() -> None:
    for messages in (drive(), states()):
        site = poses([], messages)
        for stamp_ns in (0, 7 * STEP_NS, 19 * STEP_NS):
            found = site.T_fixed_site(stamp_ns)
            assert found is not None
            np.testing.assert_allclose(found.matrix, pose(stamp_ns).matrix, atol=1e-9)
        assert site.T_fixed_site(30 * STEP_NS) is None
    wanted = load_config(settings=["combine.motion.topic=/odom"])
    off = load_config(settings=["combine.motion.enabled=false"])
    for still in (poses(), poses([]), poses([], config=wanted), poses(drive(), config=off)):
        found = still.T_fixed_site(5)
        assert found is not None
        np.testing.assert_array_equal(found.matrix, np.eye(4))


def test_boxes_in_the_site() -> None:
    T = transform("site", "odom", (10, 0, 1), 1.0)
    boxes = truth_boxes([(1, 0, 0, 1, 1, 1, 0.25), (0, 2, 0, 1, 1, 1, 3)], [1, 2], labels=["car", "van"])
    found = boxes_in_site(boxes, T)
    assert (found.frame_id, found.stamp_ns) == ("site", boxes.stamp_ns)
    np.testing.assert_allclose(found.yaws, [1.25, 4.0 - 2 * np.pi])
    np.testing.assert_allclose(found.centers, T.apply(boxes.centers))
    assert found.labels.tolist() == ["car", "van"]
    assert len(boxes_in_site(boxes.select(np.zeros(2, np.bool_)), T)) == 0
