"""The message types of ROS releases, with those of `definitions/` that rosbags does not bring.

A file of `definitions/` holds the types of one package: each begins with a line of 80 `=` and `MSG: package/msg/Type`.
"""

from functools import cache
from importlib.resources import files
from typing import Literal

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

__all__ = ["RosVersion", "extra_types", "message_types", "release_types"]

RosVersion = Literal[1, 2]

_SEPARATOR = "=" * 80 + "\nMSG: "

BEFORE_VISION_MSGS_4 = {"crystal", "bouncy", "dashing", "eloquent", "foxy", "galactic"}
"""Releases with older vision_msgs (2D boxes and hypotheses differ), whose definitions are not included."""


@cache
def extra_types(ros_version: RosVersion) -> Typesdict:
    """The types of `definitions/`, by name."""
    types: Typesdict = {}
    for folder in ("both", f"ros{ros_version}"):
        packages = files("pipeline.core.ros").joinpath("definitions", folder).iterdir()
        for file in sorted(packages, key=lambda file: file.name):
            for block in file.read_text(encoding="utf-8").split(_SEPARATOR)[1:]:
                name, _, text = block.partition("\n")
                types |= get_types_from_msg(text, name)
    return types


@cache
def message_types(ros_version: RosVersion) -> Typestore:
    """All types of ROS 1 Noetic or ROS 2 Humble."""
    return release_types(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)


@cache
def release_types(release: Stores) -> Typestore:
    """All types of a ROS release."""
    store = get_typestore(release)
    extra = extra_types(1 if release == Stores.ROS1_NOETIC else 2)
    is_old = release.value.removeprefix("ros2_") in BEFORE_VISION_MSGS_4
    store.register({name: one for name, one in extra.items() if not (is_old and name.startswith("vision_msgs/"))})
    return store
