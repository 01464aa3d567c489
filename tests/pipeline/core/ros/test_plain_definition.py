"""rosbags' grammar is the judge."""

import pytest
from rosbags.typesys import get_types_from_msg

from pipeline.core.ros.plain_definition import parse_definition
from pipeline.core.ros.typestores import definition_texts

OURS = [(ros_version, name) for ros_version in (1, 2) for name in definition_texts(ros_version)]


@pytest.mark.parametrize(("ros_version", "name"), OURS)
def test_our_definitions_say_what_rosbags_finds_in_them(ros_version: int, name: str) -> None:
    text = definition_texts(ros_version)[name]
    assert parse_definition(name, text) == get_types_from_msg(text, name)[name]


@pytest.mark.parametrize(
    "line",
    [
        "float64 x",
        "uint8[] data",
        "float64[36] covariance",
        "Header header",
        "geometry_msgs/Pose[] poses",
        "Point2 place",
        "int32 LOW=-5",
        "# a comment",
        "",
    ],
)
def test_each_kind_of_line(line: str) -> None:
    text = f"bool first\n{line}\nstring last\n"
    assert (
        parse_definition("some_msgs/msg/One", text)
        == get_types_from_msg(text, "some_msgs/msg/One")["some_msgs/msg/One"]
    )


@pytest.mark.parametrize("line", ["string<=5 name", "float64[<=3] values", "float64 x 1.0", 'string NAME="a"', "x"])
def test_other_lines_are_refused(line: str) -> None:
    with pytest.raises(ValueError, match="some_msgs/msg/One: expected a field or a constant, found"):
        parse_definition("some_msgs/msg/One", line)
