"""The message types of ROS releases, with those of `definitions/` that rosbags does not bring.

A file of `definitions/` holds the types of one package: each begins with a line of 80 `=` and `MSG: package/msg/Type`.
Its JSON files hold the types of Noetic and Humble that lidcam names, because whole releases take 0.1 s each;
`tests/support/named_types.py` writes them.
"""

import json
from functools import cache
from importlib.resources import files
from typing import Any, Literal

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

RosVersion = Literal[1, 2]

_SEPARATOR = "=" * 80 + "\nMSG: "

BEFORE_VISION_MSGS_4 = {"crystal", "bouncy", "dashing", "eloquent", "foxy", "galactic"}
"""Releases with older vision_msgs (2D boxes and hypotheses differ), whose definitions are not included."""


@cache
def extra_types(ros_version: RosVersion) -> Typesdict:
    """The types of `definitions/`, by name."""
    types: Typesdict = {}
    for folder in ("both", f"ros{ros_version}"):
        packages = files("lidcam.pipeline.core.ros").joinpath("definitions", folder).iterdir()
        for file in sorted(packages, key=lambda file: file.name):
            for block in file.read_text(encoding="utf-8").split(_SEPARATOR)[1:]:
                name, _, text = block.partition("\n")
                types |= get_types_from_msg(text, name)
    return types


@cache
def message_types(ros_version: RosVersion) -> Typestore:
    """The types of ROS 1 Noetic or ROS 2 Humble that lidcam names, and those that they contain."""
    text = (
        files("lidcam.pipeline.core.ros").joinpath("definitions", f"ros{ros_version}.json").read_text(encoding="utf-8")
    )
    store = Typestore()
    store.register({name: _tuples(definition) for name, definition in json.loads(text).items()})
    return store


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def known_types(release: Stores) -> Typestore:
    """`message_types` where they are of this release, else all of its types."""
    named: dict[Stores, RosVersion] = {Stores.ROS1_NOETIC: 1, Stores.ROS2_HUMBLE: 2}
    return message_types(named[release]) if release in named else release_types(release)


def known_type(name: str, release: Stores = Stores.ROS2_HUMBLE) -> Any:
    """A release's definition of a type; None if it has none."""
    return known_types(release).fielddefs.get(name) or release_types(release).fielddefs.get(name)


@cache
def release_types(release: Stores) -> Typestore:
    """All types of a ROS release."""
    store = get_typestore(release)
    extra = extra_types(1 if release == Stores.ROS1_NOETIC else 2)
    is_old = release.value.removeprefix("ros2_") in BEFORE_VISION_MSGS_4
    store.register({name: one for name, one in extra.items() if not (is_old and name.startswith("vision_msgs/"))})
    return store
