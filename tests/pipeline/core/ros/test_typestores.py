import re

import pytest
from helpers import shared
from named_types import RELEASES, file_of, named_types
from rosbags.typesys import Stores, get_typestore

from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.ros.typestores import RosVersion, extra_types, message_types, release_types

TYPES = (
    "foxglove_msgs/msg/ImageAnnotations",
    "foxglove_msgs/msg/SceneUpdate",
    "vision_msgs/msg/Detection2DArray",
    "vision_msgs/msg/Detection3DArray",
)


def fields(text: str) -> list[str]:
    """Lines that take part in the layout, in order."""
    return [line.strip() for line in text.splitlines() if line.strip() and "=" not in line]


def constants(text: str) -> set[str]:
    return {line.strip() for line in text.splitlines() if "=" in line}


@pytest.mark.parametrize("name", [*TYPES, "msgs/msg/MsgLidCam", "sensor_msgs/msg/Image"])
def test_a_schema_holds_all_that_it_depends_on(name: str) -> None:
    top, *others = re.split(r"={80}\nMSG: (.+)\n", ROS2.definition(name))
    have = set(others[::2])
    used = set(re.findall(r"^(\w+/\w+)", "\n".join([top, *others[1::2]]), re.MULTILINE))
    assert used == have


def test_our_copies_equal_the_published_definitions() -> None:
    blocks = re.split(r"={80}\nMSG: (.+)\n", shared("reference/msgdefs/all_msgs.txt").read_text())[1:]
    published = dict(zip(blocks[::2], blocks[1::2], strict=True))
    store = release_types(RELEASES[2])
    ours = {name for name in store.fielddefs if name.startswith(("foxglove_msgs/", "vision_msgs/"))}
    assert ours - published.keys() == {"foxglove_msgs/msg/CompressedPointCloud"}, "newer than the copy"
    for name in ours & published.keys():
        text = store.generate_msgdef(name, ros_version=2)[0].partition("=" * 80)[0]
        package = name.split("/")[0]
        expected = re.sub(rf"^(?:{package}/)?([A-Z])", rf"{package}/\1", published[name], flags=re.MULTILINE)
        assert fields(text) == fields(expected), name
        assert constants(text) == constants(expected), name


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


def test_no_definition_is_kept_that_rosbags_brings() -> None:
    assert not {*extra_types(1)} & {*get_typestore(Stores.ROS1_NOETIC).fielddefs}
    assert not {*extra_types(2)} & {*get_typestore(Stores.ROS2_HUMBLE).fielddefs}


@pytest.mark.parametrize("version", RELEASES)
def test_named_types_are_kept_as_rosbags_has_them(version: RosVersion) -> None:
    assert file_of(version).read_text() == named_types(version), "run python tests/support/named_types.py"
    kept, known = message_types(version).fielddefs, release_types(RELEASES[version]).fielddefs
    assert kept == {name: known[name] for name in kept}
