from typing import Any

import builders
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.errors import MessageError
from readers.messages.odometry import OdometrySample, decode_odometry

STAMP_NS = 1_700_000_000_123_456_789
MSGTYPE = "nav_msgs/msg/Odometry"


def decode(encoding: builders.Encoding = "cdr", **options: Any) -> OdometrySample:
    twist = options.pop("twist", {})
    body = {**builders.odometry(stamp_ns=STAMP_NS, **options), "twist": {"twist": twist}}
    return decode_odometry(builders.raw("/odom", MSGTYPE, body, STAMP_NS, encoding=encoding))


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_pose_and_twist(encoding: builders.Encoding) -> None:
    rotation = Rotation.from_euler("zyx", [0.7, -0.2, 0.1])
    sample = decode(
        encoding,
        frame_id="/odom",
        child_frame_id="base_link",
        position=(1.0, -2.0, 3.0),
        orientation_xyzw=rotation.as_quat().tolist(),
        twist={"linear": {"x": 4.0, "y": 5.0, "z": 6.0}, "angular": {"x": 7.0, "y": 8.0, "z": 9.0}},
    )
    assert (sample.stamp_ns, sample.frame_id, sample.child_frame_id) == (STAMP_NS, "odom", "base_link")
    assert (sample.T_parent_child.dst, sample.T_parent_child.src) == ("odom", "base_link")
    np.testing.assert_allclose(sample.T_parent_child.matrix[:3, :3], rotation.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(sample.T_parent_child.translation, [1, -2, 3])
    np.testing.assert_array_equal(sample.linear_velocity, [4, 5, 6])
    np.testing.assert_array_equal(sample.angular_velocity, [7, 8, 9])


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


def test_other_type() -> None:
    with pytest.raises(MessageError, match="expected nav_msgs/msg/Odometry"):
        decode_odometry(builders.raw("/image", "sensor_msgs/msg/Image", {}, STAMP_NS))


def test_a_publisher_that_does_not_name_what_moves() -> None:
    message = builders.raw("/odom", MSGTYPE, builders.odometry(stamp_ns=1, child_frame_id=""), 1)
    assert decode_odometry(message).child_frame_id == ""
