"""Definitions of messages as `definitions/` has them: whole numbers as constants, and neither bounds nor defaults.

rosbags' grammar knows all that ROS allows, and takes a millisecond for each definition: a run that writes needs thirty.
"""

import re
from collections.abc import Mapping
from typing import get_args

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import BaseDesc, Basename, Constdefs, Fielddefs, NameDesc

__all__ = ["parse_definition"]

_BASE: Mapping[str, Basename] = {name: name for name in get_args(Basename) if name not in ("fixed", "wchar", "wstring")}
_LINE = re.compile(rf"({'|'.join(_BASE)}|(?:\w+/)?[A-Z]\w*)(\[(\d*)\])? +(\w+)(?:=(-?\d+))?")


def parse_definition(name: str, text: str) -> tuple[Constdefs, Fielddefs]:
    """Constants and fields of a message, as rosbags has them.

    Args:
        name: `package/msg/Type`.
        text: A field or a constant in each line; comments have lines of their own.

    Raises:
        ValueError: a line is neither.
    """
    constants: Constdefs = []
    fields: Fielddefs = []
    for line in filter(None, map(str.strip, text.splitlines())):
        if line.startswith("#"):
            continue
        if (found := _LINE.fullmatch(line)) is None:
            raise ValueError(f"{name}: expected a field or a constant, found {line!r}")
        kind, brackets, length, field, value = found.groups()
        one = _kind(name.partition("/")[0], kind)
        if value is not None:
            constants.append((field, _BASE[kind], int(value)))
        elif brackets is None:
            fields.append((field, one))
        elif length:
            fields.append((field, (Nodetype.ARRAY, (one, int(length)))))
        else:
            fields.append((field, (Nodetype.SEQUENCE, (one, 0))))
    return constants, fields


def _kind(package: str, kind: str) -> BaseDesc | NameDesc:
    if kind in _BASE:
        return Nodetype.BASE, (_BASE[kind], 0)
    if kind == "Header":
        return Nodetype.NAME, "std_msgs/msg/Header"
    of, _, name = kind.rpartition("/")
    return Nodetype.NAME, f"{of or package}/msg/{name}"
