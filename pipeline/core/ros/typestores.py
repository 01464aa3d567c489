"""The message types of ROS 1 Noetic and ROS 2 Humble, with those of `definitions/` that rosbags does not bring.

A file of `definitions/` holds the types of one package: each begins with a line of 80 `=` and `MSG: package/msg/Type`.
"""

from collections.abc import Mapping
from functools import cache, partial
from importlib.resources import files
from typing import Literal

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores
from rosbags.typesys.store import Typestore

from pipeline.core.ros.lazy_typestore import lazy_typestore
from pipeline.core.ros.made_later import MadeLater
from pipeline.core.ros.plain_definition import parse_definition

__all__ = ["RosVersion", "definition_texts", "extra_types", "message_types"]

RosVersion = Literal[1, 2]

_SEPARATOR = "=" * 80 + "\nMSG: "


@cache
def definition_texts(ros_version: RosVersion) -> Mapping[str, str]:
    """The types of `definitions/`, by name."""
    blocks: dict[str, str] = {}
    for folder in ("both", f"ros{ros_version}"):
        packages = files("pipeline.core.ros").joinpath("definitions", folder).iterdir()
        for file in sorted(packages, key=lambda file: file.name):
            for block in file.read_text(encoding="utf-8").split(_SEPARATOR)[1:]:
                name, _, blocks[name] = block.partition("\n")
    return blocks


@cache
def extra_types(ros_version: RosVersion) -> Typesdict:
    """The types of `definitions/`, by name; each is parsed when it is asked for."""
    texts = definition_texts(ros_version)
    return MadeLater({}, {name: partial(parse_definition, name, text) for name, text in texts.items()})


@cache
def message_types(ros_version: RosVersion) -> Typestore:
    """All types of one ROS version."""
    store = lazy_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    store.know(extra_types(ros_version))
    return store
