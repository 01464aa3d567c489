"""The message types of the output: those of ROS 2 Humble, and the ones that `schemas/` adds.

Each file of `schemas/` holds the types of one package: after a line of 80 `=`, `MSG: package/msg/Type` and its text.
"""

from functools import cache
from importlib.resources import files
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

__all__ = ["message_type", "output_types", "schema_text"]

_PACKAGES = ("msgs", "vision_msgs", "foxglove_msgs")
_SEPARATOR = "=" * 80 + "\nMSG: "


@cache
def output_types() -> Typestore:
    """All types that an output file may hold."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types: dict[str, Any] = {}
    for package in _PACKAGES:
        text = files("writers").joinpath("schemas", f"{package}.msg").read_text(encoding="utf-8")
        for block in text.split(_SEPARATOR)[1:]:
            name, _, definition = block.partition("\n")
            types.update(get_types_from_msg(definition, name))
    store.register(types)
    return store


def message_type(name: str) -> Any:
    """The class of a message; its fields are the arguments, by name."""
    return output_types().types[name]


def schema_text(name: str) -> str:
    """A type's definition with those of everything that it is made of (MCAP's `ros2msg`)."""
    text, _ = output_types().generate_msgdef(name, ros_version=2)
    return text
