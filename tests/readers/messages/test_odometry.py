from typing import Any

import builders
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.readers.messages.odometry import decode_odometry

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
