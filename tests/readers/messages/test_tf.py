from typing import Any

import builders
import numpy as np
import pytest
from builders import Fields, raw, tf_message, transform_stamped
from memory_recording import MemoryRecording
from scipy.spatial.transform import Rotation

import lidcam.readers.messages.tf as tf_module
from lidcam.pipeline.core.errors import FrameError, MessageError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.messages.tf import decode_odometry, decode_transforms, read_transforms

STAMP_NS = 1_700_000_000_123_456_789
MSGTYPE = "nav_msgs/msg/Odometry"


def decode(encoding: builders.Encoding = "cdr", **options: Any) -> Transform:
    body = builders.odometry(stamp_ns=STAMP_NS, **options)
    return decode_odometry(builders.raw("/odom", MSGTYPE, body, STAMP_NS, encoding=encoding))


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_the_pose(encoding: builders.Encoding) -> None:
    rotation = Rotation.from_euler("zyx", [0.7, -0.2, 0.1])
    pose = decode(
        encoding,
        frame_id="/odom",
        child_frame_id="base_link",
        position=(1.0, -2.0, 3.0),
        orientation_xyzw=rotation.as_quat().tolist(),
    )
    assert (pose.dst, pose.src) == ("odom", "base_link")
    np.testing.assert_allclose(pose.matrix[:3, :3], rotation.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(pose.translation, [1, -2, 3])


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"orientation_xyzw": (0.0, 0.0, 0.0, 0.0)}, r"/odom: .*expected a unit quaternion"),
        ({"orientation_xyzw": (np.nan, 0.0, 0.0, 1.0)}, r"/odom: .*nan"),
        ({"position": (np.inf, 0.0, 0.0)}, r"/odom: .*finite metres"),
        ({"child_frame_id": "odom"}, r"expected two frame names, found frame_id 'odom', child 'odom'"),
        ({"frame_id": ""}, r"expected two frame names"),
        ({"frame_id": "/base_link"}, r"expected two frame names"),
    ],
)
def test_poses_that_are_none(options: dict[str, Any], match: str) -> None:
    with pytest.raises(MessageError, match=match):
        decode(**options)


def test_other_types_and_a_publisher_that_does_not_name_the_child_frame() -> None:
    with pytest.raises(MessageError, match="expected nav_msgs/msg/Odometry"):
        decode_odometry(builders.raw("/image", "sensor_msgs/msg/Image", {}, STAMP_NS))
    assert decode(child_frame_id="").src == ""


SECOND = 10**9
TFM = "tf2_msgs/msg/TFMessage"


def tf(topic: str, *transforms: Fields, at_s: float = 0, encoding: str = "cdr") -> RawMessage:
    stamp_ns = round(at_s * SECOND)
    return raw(topic, TFM, tf_message(transforms), stamp_ns, encoding=encoding)  # type: ignore[arg-type]  # two literals


def edge(parent: str, child: str, x: float = 0.0, **options: object) -> Fields:
    return transform_stamped(parent, child, stamp_ns=0, translation=(x, 0, 0), **options)  # type: ignore[arg-type]  # passed on


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_static_transforms_chain_and_slashes_go(encoding: str) -> None:
    messages = [tf("/tf_static", edge("/base", "/mast", 1.0), edge("mast", "lidar", 2.0), encoding=encoding)]
    found = read_transforms(MemoryRecording(messages))
    np.testing.assert_allclose(found.lookup("base", "lidar").translation, [3, 0, 0])
    later = tf("/tf_static", edge("mast", "lidar", 5.0), at_s=9, encoding=encoding)
    found = read_transforms(MemoryRecording([*messages, later]))
    np.testing.assert_allclose(found.lookup("base", "lidar").translation, [6, 0, 0])
    assert read_transforms(MemoryRecording([])).fixed.frames == frozenset()


def test_mountings_repeated_on_tf_are_fixed_and_moving_ones_are_not() -> None:
    messages = [
        tf("/tf", edge("base", "lidar", 1.0), edge("turret", "gun", 0.01 * i), edge("odom", "base", 5.0), at_s=i)
        for i in range(5)
    ]
    found = read_transforms(MemoryRecording(messages))
    assert dict(found.moving) == {"gun": "turret", "base": "odom"}  # odom never holds still for good
    np.testing.assert_allclose(found.lookup("base", "lidar").translation[0], 1)
    with pytest.raises(FrameError, match="base moves in odom"):
        found.lookup("odom", "lidar")


def test_of_a_frame_known_to_move_only_what_is_new_is_told() -> None:
    moving = [tf("/tf", edge("base", "wheel", 0.01 * i), at_s=i) for i in range(3)]
    unsound = tf("/tf", edge("base", "wheel", float("nan")), at_s=4)
    found = read_transforms(MemoryRecording([*moving, tf("/tf", edge("axle", "wheel"), at_s=3), unsound]))
    assert dict(found.moving) == {"wheel": "axle"}
    assert "finite" in found.faults["wheel"]
    assert decode_transforms(moving[0], is_wanted=lambda parent, child: (parent, child) != ("base", "wheel")) == []
    ((_, fault, child),) = decode_transforms(unsound, is_wanted=lambda _parent, _child: False)
    assert isinstance(fault, FrameError)
    assert child == "wheel"


def test_only_the_beginning_of_tf_is_read_but_all_of_tf_static() -> None:
    messages = [
        tf("/tf", edge("base", "a")),
        tf("/tf", edge("base", "a"), at_s=1),
        tf("/tf", edge("base", "b"), at_s=61),
        tf("/tf_static", edge("base", "c"), at_s=99),
    ]
    assert read_transforms(MemoryRecording(messages)).fixed.frames == {"base", "a", "c"}


@pytest.mark.parametrize(("stop_s", "moves"), [(None, True), (70, False), (130, True)])
def test_what_drives_off_late_moves(stop_s: float | None, moves: bool) -> None:
    times_s = (0, 30, 100, 129)
    messages = [tf("/tf", edge("world", "car", max(0, at_s - 60)), edge("car", "a"), at_s=at_s) for at_s in times_s]
    found = read_transforms(MemoryRecording(messages), stop_ns=None if stop_s is None else round(stop_s * SECOND))
    assert dict(found.moving) == ({"car": "world"} if moves else {})
    assert found.are_joined("world", "a") != moves


@pytest.mark.parametrize("early", [tf("/tf", edge("base", "a")), tf("/other", edge("base", "a"))])
def test_one_log_time_that_is_far_too_early_does_not_hide_the_rest(early: RawMessage) -> None:
    """Nor does it where it is that of another topic: the time before the first transform does not count."""
    messages = [tf("/tf", edge("base", name), at_s=10**9 + at_s) for name, at_s in (("b", 0), ("c", 59), ("d", 61))]
    found = read_transforms(MemoryRecording([early, *messages]))
    assert found.fixed.frames >= {"base", "b", "c"}
    assert "d" not in found.fixed.frames


@pytest.mark.parametrize(
    ("start_s", "stop_s", "expected"),
    [
        (None, None, "abc"),
        (None, 1.5, "ab"),  # never less than the first two seconds
        (None, 50, "abc"),
        (30, 35, "ab"),
        (30, 70, "abde"),
        (69, None, "abe"),
        (1, 20, "abc"),
    ],
)
def test_of_a_window_tf_is_read_where_it_begins_and_where_the_recording_does(
    start_s: float | None, stop_s: float | None, expected: str
) -> None:
    times_s = {"a": 0, "b": 1.9, "c": 10, "d": 60, "e": 69.9, "f": 130}
    messages = [tf("/tf", edge("base", name), at_s=at_s) for name, at_s in times_s.items()]
    start_ns, stop_ns = (None if at_s is None else round(at_s * SECOND) for at_s in (start_s, stop_s))
    found = read_transforms(MemoryRecording(messages), start_ns=start_ns, stop_ns=stop_ns)
    assert found.fixed.frames == {"base", *expected}


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (edge("base", "lidar", rotation_xyzw=(0, 0, 0, 0)), "not a unit quaternion"),
        (edge("base", "lidar", rotation_xyzw=(0, 0, 0, float("nan"))), "not a unit quaternion"),
        (edge("base", "lidar", float("inf")), "finite"),
        (edge("lidar", "lidar"), "two different frames"),
    ],
)
def test_an_unsound_transform_is_left_out_and_its_reason_told(bad: Fields, reason: str) -> None:
    found = read_transforms(MemoryRecording([tf("/tf_static", bad, edge("base", "other"))]))
    assert found.fixed.edge("other") is not None
    with pytest.raises(FrameError, match=reason):
        found.lookup("base", "lidar")


def test_an_undecodable_message_is_counted() -> None:
    good = tf("/tf_static", edge("base", "lidar"))
    bad = good._replace(data=bytes(good.data)[:-9])
    found = read_transforms(MemoryRecording([bad, good, *[bad] * 500]))
    assert [(drop.topic, drop.reason, n) for drop, n in found.drops] == [("/tf_static", "cannot be decoded", 501)]
    assert found.fixed.edge("lidar") is not None


def test_more_frames_than_transforms_may_name() -> None:
    links = [transform_stamped("base", f"f{i}", stamp_ns=1) for i in range(5)]
    messages = [tf("/tf_static", link, at_s=i) for i, link in enumerate([*links, links[0]], 1)]
    found = read_transforms(MemoryRecording(messages), limits=RecordingLimits(max_frames=3))
    assert {frame for frame in found.fixed.frames if frame != "base"} == {"f0", "f1", "f2"}
    ((drop, count),) = found.drops
    assert drop.detail == "/tf_static: transforms of more than 3 coordinate frames: raise limit_scale"
    assert count == 2


def test_transforms_are_read_up_to_a_size(monkeypatch: pytest.MonkeyPatch) -> None:
    messages = [tf("/tf_static", edge("base", f"f{i}")) for i in range(1, 5)]
    monkeypatch.setattr(tf_module, "MAX_TF_BYTES", 2 * len(messages[0].data))
    found = read_transforms(MemoryRecording(messages))
    assert {frame for frame in found.fixed.frames if frame != "base"} == {"f1", "f2"}
