from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from builders import Fields, odometry, pointcloud2, raw, tf_message, transform_stamped
from memory_recording import MemoryRecording
from scipy.spatial.transform import Rotation, Slerp

from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.frame import SensorBundle, own_motion
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.settings.combine import MotionConfig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.tf import read_transforms
from lidcam.readers.rig.discovery import discover_rig
from lidcam.readers.streams.motion import MotionBuffer, MotionSource, find_motion_source, links_up

MS = 1_000_000
ODOMETRY = "nav_msgs/msg/Odometry"
TFM = "tf2_msgs/msg/TFMessage"


def odom(i: int, topic: str = "/odom", **options: Any) -> RawMessage:
    """Odometry at i * 20 ms: 10 m/s forward, turning left."""
    turn = Rotation.from_euler("z", 0.01 * i).as_quat().tolist()
    stamp_ns = i * 20 * MS
    fields = odometry(stamp_ns=stamp_ns, position=(0.2 * i, 0, 0), orientation_xyzw=turn, **options)
    return raw(topic, ODOMETRY, fields, stamp_ns)


def tf(*transforms: Fields, at_ns: int = 0, topic: str = "/tf") -> RawMessage:
    return raw(topic, TFM, tf_message(transforms), at_ns)


def cloud(i: int = 0) -> RawMessage:
    fields = pointcloud2([[1, 2, 3]], stamp_ns=i * 100 * MS, frame_id="lidar")
    return raw("/points", "sensor_msgs/msg/PointCloud2", fields, i * 100 * MS)


MOUNT = tf(transform_stamped("base_link", "lidar", stamp_ns=0, translation=(1, 0, 2)), topic="/tf_static")


def source_of(*messages: RawMessage, exclude: Sequence[str] = (), **motion: Any) -> MotionSource | None:
    recording = MemoryRecording([MOUNT, cloud(), *messages])
    config = Config.model_validate({"combine": {"motion": motion}, "topics": {"exclude": exclude}})
    found = discover_rig(recording, config)
    assert found.rig.site_frame == "base_link"
    return find_motion_source(recording, found.rig, found.transforms, config)


def moving_by(*messages: RawMessage, **motion: Any) -> MotionSource:
    source = source_of(*messages, **motion)
    assert source is not None
    return source


def run(source: MotionSource, *messages: RawMessage) -> tuple[MotionBuffer, list[RawMessage], list[Drop]]:
    drops: list[Drop] = []
    buffer = MotionBuffer(source, on_drop=drops.append)
    return buffer, list(buffer.tap(messages)), drops


# --- which source


def test_odometry_of_a_fixed_neighbour_is_taken_with_the_offset_between() -> None:
    source = moving_by(odom(0, child_frame_id="lidar"), odom(10, child_frame_id="lidar"))
    buffer, _, _ = run(source, *(odom(i, child_frame_id="lidar") for i in range(10)))
    poses = buffer.window(100 * MS)
    np.testing.assert_allclose(poses.T_fixed_moving[0] @ [1, 0, 2, 1], [0, 0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("messages", "settings"),
    [
        ([], {}),
        ([odom(0, "/car1/base_pose_ground_truth", frame_id="map", child_frame_id="car1/base_link")], {}),
        ([odom(0, frame_id="base_link", child_frame_id="car1")], {}),  # where a car is in the scene
        ([odom(0, child_frame_id="")], {}),
        ([odom(0)._replace(data=b"\0\1\0\0")], {}),
        ([odom(0)], {"enabled": False}),
    ],
)
def test_there_is_no_motion_of_the_rig(messages: list[RawMessage], settings: dict[str, Any]) -> None:
    assert source_of(*messages, **settings) is None


def test_fixed_frames_in_a_circle_do_not_move() -> None:
    circle = tf(*(transform_stamped(a, b, stamp_ns=0) for a, b in ("ab", "ba")), topic="/tf_static")
    assert links_up("a", read_transforms(MemoryRecording([circle])), is_end=lambda _: False) is None


def test_a_configured_topic_may_leave_its_frame_unnamed() -> None:
    source = moving_by(odom(0), odom(0, "/other", child_frame_id=""), topic="/other")
    assert source.topics == ("/other",)
    buffer, _, drops = run(source, *(odom(i, "/other", child_frame_id="") for i in range(5)))
    assert len(buffer.window(0)) == 5
    assert drops == []


@pytest.mark.parametrize(
    ("topic", "reason"),
    [("/nowhere", "expected a recorded nav_msgs/msg/Odometry .* found '/nowhere'"), ("/car", "odometry of 'car'")],
)
def test_a_wrong_configured_topic_is_an_error(topic: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        source_of(odom(0), odom(0, "/car", child_frame_id="car"), topic=topic)


def test_the_densest_odometry_wins_then_the_first_by_name() -> None:
    both = [odom(0, "/b"), odom(0, "/a")]
    assert source_of(*both).topics == ("/a",)  # type: ignore[union-attr]  # None would fail, too
    assert source_of(*both, odom(1, "/b")).topics == ("/b",)  # type: ignore[union-attr]  # None would fail, too


def test_tf_is_the_last_resort_up_to_odom() -> None:
    steps = [
        tf(
            transform_stamped("odom", "footprint", stamp_ns=i * 20 * MS, translation=(0.2 * i, 0, 0)),
            transform_stamped("map", "odom", stamp_ns=i * 20 * MS, translation=(0, i, 0)),
            at_ns=i * 20 * MS,
        )
        for i in range(50)
    ]
    between = tf(transform_stamped("footprint", "base_link", stamp_ns=0, translation=(0, 0, 0.5)), topic="/tf_static")
    source = moving_by(between, *steps)
    assert (source.topics, source.frame_id, source.fixed_frame_id) == (("/tf",), "base_link", "odom")
    buffer, forwarded, drops = run(source, *steps)
    assert (forwarded, drops) == ([], [])
    poses = buffer.window(500 * MS)
    at = int(np.searchsorted(poses.stamps_ns, 500 * MS))
    np.testing.assert_allclose(poses.T_fixed_moving[at][:3, 3], [5, 0, 0.5])


def test_two_moving_frames_are_joined_at_the_denser_ones_stamps() -> None:
    source = MotionSource(("/tf",), "base_link", "odom", ("base_link", "footprint"))
    turns = [Rotation.from_euler("z", 0.1 * i) for i in range(6)]
    turned = [
        transform_stamped("odom", "footprint", stamp_ns=i * 100 * MS, rotation_xyzw=turn.as_quat().tolist())
        for i, turn in enumerate(turns)
    ]
    coarse = [tf(one, at_ns=i * 100 * MS) for i, one in enumerate(turned)]
    fine = [
        tf(transform_stamped("footprint", "base_link", stamp_ns=i * 30 * MS, translation=(1, 0, 0)), at_ns=1)
        for i in range(30)
    ]
    buffer, _, _ = run(source, *coarse, *fine)
    poses = buffer.window(250 * MS)
    assert poses.stamps_ns.tolist() == list(range(0, 500 * MS, 30 * MS))
    judge = Slerp(np.arange(6) * 100.0 * MS, Rotation.concatenate(turns))(poses.stamps_ns.astype(float))
    np.testing.assert_allclose(poses.T_fixed_moving[:, :3, 3], judge.apply([1, 0, 0]), atol=1e-12)


# --- the buffer

ODOM, TF = (MotionSource((topic,), "base_link", "odom", ("base_link",)) for topic in ("/odom", "/tf"))


def test_other_messages_pass_and_poses_lie_around_the_stamp() -> None:
    messages = [odom(i) for i in range(200)] + [cloud(i) for i in range(3)]
    buffer, forwarded, drops = run(ODOM, *messages)
    assert [message.topic for message in forwarded] == ["/points"] * 3
    assert drops == []
    poses = buffer.window(2000 * MS)
    assert (poses.frame_id, poses.fixed_frame_id) == ("base_link", "odom")
    assert (poses.stamps_ns[0], poses.stamps_ns[-1]) == (1480 * MS, 2520 * MS)  # half a second, and one more each side
    at = poses.stamps_ns.tolist().index(2000 * MS)
    np.testing.assert_allclose(poses.T_fixed_moving[at][:3, 3], [20, 0, 0])
    np.testing.assert_allclose(poses.T_fixed_moving[at][1, 0], np.sin(1.0))


def test_the_buffer_is_bounded() -> None:
    buffer, _, _ = run(ODOM, *(odom(i) for i in range(2000)))
    assert len(buffer.window(10_000 * MS)) == 0
    newest = buffer.window(39_980 * MS)
    assert len(newest) <= 52


@pytest.mark.parametrize(("at_s", "is_known"), [(1.0, False), (3.0, True), (5.0, False)])
def test_where_poses_are_missing_the_rig_does_not_count_as_standing(at_s: float, is_known: bool) -> None:
    buffer, _, _ = run(ODOM, *(odom(i) for i in range(100, 200)))
    stamp_ns = round(at_s * 1000) * MS
    bundle = SensorBundle(0, stamp_ns, stamp_ns, {}, motion=buffer.window(stamp_ns))
    assert (own_motion(bundle, stamp_ns - 20 * MS, "base_link", MotionConfig()) is not None) == is_known


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (odom(3)._replace(data=b"\0\1\0\0abc"), "cannot be decoded"),
        (cloud()._replace(channel=replace(cloud().channel, topic="/odom")), "cannot be decoded"),
        (odom(3, frame_id="map"), "its pose is unusable"),
        (odom(3, child_frame_id="other_car"), "its pose is unusable"),
        (raw("/odom", ODOMETRY, odometry(stamp_ns=3, orientation_xyzw=(0, 0, 0, 0)), 3), "cannot be decoded"),
    ],
)
def test_bad_messages_are_counted_and_the_rest_is_used(bad: RawMessage, reason: str) -> None:
    buffer, forwarded, drops = run(ODOM, odom(0), bad, odom(1))
    assert [(drop.topic, drop.reason) for drop in drops] == [("/odom", reason)]
    assert forwarded == []
    assert len(buffer.window(0)) == 2


def test_a_new_parent_in_tf_is_counted_and_not_mixed_in() -> None:
    good = [tf(transform_stamped("odom", "base_link", stamp_ns=i), at_ns=i) for i in range(3)]
    bad = tf(
        transform_stamped("map", "base_link", stamp_ns=3),
        transform_stamped("odom", "base_link", stamp_ns=4, rotation_xyzw=(0, 0, 0, 0)),
        transform_stamped("odom", "base_link", stamp_ns=5),
        at_ns=3,
    )
    buffer, _, (drop,) = run(TF, *good, bad)
    assert (drop.reason, drop.detail) == ("its pose is unusable", "base_link in 'map', expected 'odom'")
    assert buffer.window(0).stamps_ns.tolist() == [0, 1, 2, 5]


@pytest.mark.parametrize("wrong_s", [-30, 10**6, 2**31])
@pytest.mark.parametrize("kind", ["odometry", "tf"])
def test_a_first_pose_far_off_does_not_cost_the_others(kind: str, wrong_s: int) -> None:
    def pose(i: int) -> RawMessage:
        stamp_ns = (1000 + wrong_s) * 10**9 if i == 0 else 1000 * 10**9 + i * 20 * MS
        if kind == "odometry":
            return odom(i)._replace(stamp_ns=stamp_ns)
        sent = transform_stamped("odom", "base_link", stamp_ns=i, translation=(0.2 * i, 0, 0))
        message = tf(sent, at_ns=1000 * 10**9 + i * 20 * MS)
        data = bytearray(message.data)
        data[8:16] = b"".join(part.to_bytes(4, "little") for part in divmod(stamp_ns, 10**9))
        return message._replace(data=bytes(data))

    messages = [pose(i) for i in range(50)]
    source = moving_by(*messages)
    buffer, _, drops = run(source, *messages)
    assert len(drops) == (wrong_s > 0)  # one far behind may be from before a pause
    poses = buffer.window(1000 * 10**9 + 25 * 20 * MS)
    assert poses.stamps_ns[-1] == 1000 * 10**9 + 49 * 20 * MS
    assert len(poses.stamps_ns) >= 48
