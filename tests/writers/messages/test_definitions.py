import re

import pytest
from helpers import shared

from writers.messages.definitions import output_types, schema_text

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
    top, *others = re.split(r"={80}\nMSG: (.+)\n", schema_text(name))
    have = set(others[::2])
    used = set(re.findall(r"^(\w+/\w+)", "\n".join([top, *others[1::2]]), re.MULTILINE))
    assert used == have


def test_our_copies_equal_the_published_definitions() -> None:
    blocks = re.split(r"={80}\nMSG: (.+)\n", shared("reference/msgdefs/all_msgs.txt").read_text())[1:]
    published = dict(zip(blocks[::2], blocks[1::2], strict=True))
    store = output_types()
    ours = {name for name in store.fielddefs if name.startswith(("foxglove_msgs/", "vision_msgs/"))}
    assert ours
    for name in ours:
        text = store.generate_msgdef(name, ros_version=2)[0].partition("=" * 80)[0]
        package = name.split("/")[0]
        expected = re.sub(rf"^(?:{package}/)?([A-Z])", rf"{package}/\1", published[name], flags=re.MULTILINE)
        assert fields(text) == fields(expected), name
        assert constants(text) == constants(expected), name
