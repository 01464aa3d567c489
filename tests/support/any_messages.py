"""Messages of any type with values by chance, as rosbags has them."""

from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from pipeline.core.ros.typestores import message_types

__all__ = ["TYPES", "made"]

STORE = message_types(2)
PACKAGES = (
    "diagnostic_msgs/",
    "foxglove_msgs/",
    "msgs/",
    "sensor_msgs/",
    "tf2_msgs/",
    "vision_msgs/",
    "visualization_msgs/",
)
TYPES = sorted(name for name in STORE.types if name.startswith(PACKAGES))
WHOLE = {"byte", "char", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}


def number(kind: str, rng: np.random.Generator) -> Any:
    if kind == "bool":
        return bool(rng.integers(2))
    if kind in WHOLE:
        info = np.iinfo({"byte": "int8", "char": "uint8"}.get(kind, kind))
        return int(rng.integers(info.min, info.max, endpoint=True, dtype=info.dtype))
    return float(np.dtype(kind).type(rng.normal()))


def value(desc: Any, rng: np.random.Generator, longest: int) -> Any:
    if desc[0] == Nodetype.NAME:
        return made(desc[1], rng, longest)
    if desc[0] == Nodetype.BASE:
        if desc[1][0] == "string":
            return "".join(rng.choice([*"abcä7 "], rng.integers(0, 9)))
        return number(desc[1][0], rng)
    of, length = desc[1]
    count = length if desc[0] == Nodetype.ARRAY else int(rng.integers(0, longest + 1))
    values = [value(of, rng, longest) for _ in range(count)]
    if of[0] == Nodetype.BASE and of[1][0] != "string":
        return np.array(values, {"byte": "int8", "char": "uint8"}.get(of[1][0], of[1][0]))
    return values


def made(msgtype: str, rng: np.random.Generator, longest: int = 2) -> Any:
    fields = STORE.get_msgdef(msgtype).fields
    return STORE.types[msgtype](*(value(desc, rng, longest) for _, desc in fields))
