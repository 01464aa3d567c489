import pytest

from bags.simulator.recorder.message_types import message_types

# As `rosmsg md5` of genuine installations tells them (Noetic; ros-drivers and ros-perception releases).
NOETIC = {
    "velodyne_msgs/msg/VelodyneScan": "50804fc9533a0e579e6322c04ae70566",
    "ackermann_msgs/msg/AckermannDriveStamped": "1fd5d7f58889cefd44d29f6653240d0c",
    "vision_msgs/msg/Detection3DArray": "05c51d9aea1fb4cfdc8effb94f197b6f",
    "tf2_msgs/msg/TFMessage": "94810edda583a504dfda3829e70d7eec",
    "sensor_msgs/msg/CameraInfo": "c9a58c1b0b154e0e6da7578cb991d214",
}


@pytest.mark.parametrize("name", NOETIC)
def test_definitions_of_ros_1_have_the_genuine_sums(name: str) -> None:
    _, md5sum = message_types(1).generate_msgdef(name, ros_version=1)
    assert md5sum == NOETIC[name]
