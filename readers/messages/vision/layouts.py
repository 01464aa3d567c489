"""The layouts of arrays of boxes in the versions of vision_msgs, told by the recorded definition.

They differ in what the class of a hypothesis is, how many numbers a box has, and what follows the box.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict

from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel
from readers.messages.deserialize import typestore_for

__all__ = ["BoxLayout", "Tail", "layout_of"]

Tail = Literal["id", "tracking", "cloud", "image", "none"]

_Fields: TypeAlias = tuple[tuple[str, Any], ...]
"""Names and kinds of fields, those of parts with their path; the kind of a list of messages is a tuple of fields."""


class BoxLayout(NamedTuple):
    """How a message of boxes lies in bytes: header, boxes, of each its header, its hypotheses, itself, and the tail.

    Attributes:
        has_numbers: Whether classes are int64, not strings.
        numbers: float64 of a box: 10 of position, orientation and size in space, 5 of centre, angle and size in images.
        tail: What follows the box: its `id`, `tracking` (a bool and the id), the points or pixels that show it.
    """

    has_numbers: bool
    numbers: int
    tail: Tail


def _floats(*names: str) -> _Fields:
    return tuple((name, "float64") for name in names)


_HEADER = (("stamp.sec", "int32"), ("stamp.nanosec", "uint32"), ("frame_id", "string"))
_SEQ_HEADER = (("seq", "uint32"), *_HEADER)
_POSE = tuple(f"{part}.{axis}" for part, axes in (("position", "xyz"), ("orientation", "xyzw")) for axis in axes)
_BOXES = (
    _floats(*(f"center.{name}" for name in _POSE), "size.x", "size.y", "size.z"),
    _floats("center.position.x", "center.position.y", "center.theta", "size_x", "size_y"),
    _floats("center.x", "center.y", "center.theta", "size_x", "size_y"),
)
_POSED = (*_floats(*(f"pose.pose.{name}" for name in _POSE)), ("pose.covariance[36]", "float64"))
_HYPOTHESES: dict[_Fields, bool] = {
    (("id", "int64"), ("score", "float64"), *_POSED): True,
    (("id", "string"), ("score", "float64"), *_POSED): False,
    (("hypothesis.class_id", "string"), ("hypothesis.score", "float64"), *_POSED): False,
}
_POINT_FIELD = (("name", "string"), ("offset", "uint32"), ("datatype", "uint8"), ("count", "uint32"))
_CLOUD = (
    *((f"header.{name}", kind) for name, kind in _SEQ_HEADER),
    ("height", "uint32"),
    ("width", "uint32"),
    ("fields[]", _POINT_FIELD),
    ("is_bigendian", "bool"),
    ("point_step", "uint32"),
    ("row_step", "uint32"),
    ("data[]", "uint8"),
    ("is_dense", "bool"),
)
_IMAGE = (
    *((f"header.{name}", kind) for name, kind in _SEQ_HEADER),
    ("height", "uint32"),
    ("width", "uint32"),
    ("encoding", "string"),
    ("is_bigendian", "uint8"),
    ("step", "uint32"),
    ("data[]", "uint8"),
)
_TAILS: dict[_Fields, Tail] = {
    (): "none",
    (("id", "string"),): "id",
    (("is_tracking", "bool"), ("tracking_id", "string")): "tracking",
}
_ROS1_TAILS: dict[_Fields, Tail] = {
    tuple((f"source_cloud.{name}", kind) for name, kind in _CLOUD): "cloud",
    tuple((f"source_img.{name}", kind) for name, kind in _IMAGE): "image",
}


@lru_cache(maxsize=1024)
def layout_of(channel: Channel) -> BoxLayout | None:
    """The layout of a channel's messages; None if it is none of the known ones."""
    return _layout(replace(channel, topic=""))  # many topics share one definition


@lru_cache(maxsize=256)
def _layout(channel: Channel) -> BoxLayout | None:
    try:
        types = typestore_for(channel).fielddefs
    except MessageError:
        return None
    expected = _SEQ_HEADER if channel.encoding == "ros1" else _HEADER
    header, rest = _part("header", tuple(_flat(channel.msgtype, types)))
    if header != expected or len(rest) != 1 or rest[0][0] != "detections[]":
        return None
    header, fields = _part("header", rest[0][1])
    if header != expected or not fields or fields[0][0] != "results[]":
        return None
    has_numbers = _HYPOTHESES.get(fields[0][1])
    box, behind = _part("bbox", fields[1:])
    tail = {**_TAILS, **(_ROS1_TAILS if channel.encoding == "ros1" else {})}.get(behind)
    if has_numbers is None or box not in _BOXES or tail is None:
        return None
    return BoxLayout(has_numbers, len(box), tail)


def _flat(msgtype: str, types: Typesdict, path: str = "") -> Iterator[tuple[str, Any]]:
    for name, (node, detail) in types[msgtype][1]:
        inner: Any = detail
        if node == Nodetype.NAME:
            yield from _flat(str(detail), types, f"{path}{name}.")
        elif node == Nodetype.BASE:
            yield f"{path}{name}", "int32" if (name, inner[0]) == ("sec", "uint32") else inner[0]
        else:
            (part, part_detail), length = inner
            item = tuple(_flat(part_detail, types)) if part == Nodetype.NAME else part_detail[0]
            yield f"{path}{name}[{length if node == Nodetype.ARRAY else ''}]", item


def _part(name: str, fields: _Fields) -> tuple[_Fields, _Fields]:
    """The first fields, as far as they belong to one part, without its name; and those behind."""
    prefix = f"{name}."
    count = next((row for row, (path, _) in enumerate(fields) if not path.startswith(prefix)), len(fields))
    return tuple((path.removeprefix(prefix), kind) for path, kind in fields[:count]), fields[count:]
