from typing import Any

import numpy as np
import pytest

from lidcam.pipeline.core.ros.messages import ROS2

MARKER, DETECTION = "visualization_msgs/msg/Marker", "vision_msgs/msg/Detection3D"


@pytest.mark.parametrize("msgtype", [MARKER, DETECTION, "sensor_msgs/msg/CameraInfo", "foxglove_msgs/msg/SceneEntity"])
def test_what_is_left_out_is_zero_or_empty(msgtype: str) -> None:
    (message,) = ROS2.rows(msgtype, 1)
    data = ROS2.serialize(message)
    assert not any(bytes(data[4:]).replace(b"\1\0\0\0\0", b""))  # an empty text is its length, 1, and its end
    assert bytes(ROS2.serialize(ROS2.deserialize(data, msgtype))) == bytes(data)


def test_a_column_has_a_value_of_each_message_or_one_of_all() -> None:
    found = ROS2.rows("geometry_msgs/msg/Vector3", 2, x=[1.0, 2.0], y=np.array([3.0, 4.0]), z=5.0)
    assert found == [ROS2.vector(1.0, 3.0, 5.0), ROS2.vector(2.0, 4.0, 5.0)]
    assert found[1:] == ROS2.rows_of_numbers("geometry_msgs/msg/Vector3", np.array([[2.0, 4.0, 5.0]]))


@pytest.mark.parametrize(
    ("columns", "error"), [({"x": [1.0]}, ValueError), ({"x": np.zeros(3)}, ValueError), ({"w": 1.0}, LookupError)]
)
def test_a_column_that_does_not_fit_is_refused(columns: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        ROS2.rows("geometry_msgs/msg/Vector3", 2, **columns)
