"""Reads the known layouts of vision_msgs/Detection3DArray in place, without an object for every field.

ROS 1 packs fields without gaps (wiki.ros.org/msg). CDR aligns each number to its size, counted from the end of a
four-byte encapsulation whose second byte says which end comes first (OMG formal/02-06-51, 9.3; DDSI-RTPS 10.2).
Positions are walked over in Python, numbers are gathered by numpy at the end.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict

from pipeline.core.arrays import F64
from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel, RawMessage
from pipeline.core.settings.recording import LimitsConfig
from readers.messages.deserialize import typestore_for

__all__ = ["DetectionRows", "rows_in_place"]


@dataclass(frozen=True, slots=True, eq=False)
class DetectionRows:
    """The content of a Detection3DArray, as recorded.

    Attributes:
        frame_id: As recorded.
        boxes: (N, 10) float64: position x, y, z; orientation x, y, z, w; size x, y, z.
        ids: Of each box.
        of_box: Row of the box of each hypothesis.
        labels: Class of each hypothesis; a number as text.
        scores: (H,) float64.
        covariances: (H, 36) float64, of each hypothesis' pose.
    """

    frame_id: str
    boxes: F64
    ids: list[str]
    of_box: list[int]
    labels: list[str]
    scores: F64
    covariances: F64


_Tail = Literal["id", "tracking", "cloud", "none"]


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the layouts differ: what the class of a hypothesis is, and what follows the box."""

    has_numbers: bool
    tail: _Tail


_HEADER = (("stamp.sec", "int32"), ("stamp.nanosec", "uint32"), ("frame_id", "string"))
_SEQ_HEADER = (("seq", "uint32"), *_HEADER)
_POSE = tuple(
    (f"{part}.{axis}", "float64") for part, axes in (("position", "xyz"), ("orientation", "xyzw")) for axis in axes
)
_BOX = (*((f"center.{name}", base) for name, base in _POSE), *((f"size.{axis}", "float64") for axis in "xyz"))
_POSED = (*((f"pose.pose.{name}", base) for name, base in _POSE), ("pose.covariance[36]", "float64"))
_HYPOTHESES = {
    (("id", "int64"), ("score", "float64"), *_POSED): True,
    (("id", "string"), ("score", "float64"), *_POSED): False,
    (("hypothesis.class_id", "string"), ("hypothesis.score", "float64"), *_POSED): False,
}
_TAILS: dict[tuple[Any, ...], _Tail] = {
    (("id", "string"),): "id",
    (("is_tracking", "bool"), ("tracking_id", "string")): "tracking",
    (): "none",
}
_SCORE_AND_POSE_BYTES = 8 * (1 + 7 + 36)
_BOX_BYTES = 8 * 10
_ENCAPSULATIONS: dict[bytes, Literal["<", ">"]] = {b"\0\0": ">", b"\0\1": "<"}
_POINT_FIELD_BYTES = 4 + 1 + 4  # offset, datatype, count


def rows_in_place(message: RawMessage, limits: LimitsConfig) -> DetectionRows | None:
    """The content of a message of a known layout; None if it has another, or does not fit it.

    The caller then decodes it by its definition, which says what is wrong with it.
    """
    layout = None if message.problem else _layout_of(message.channel)
    if layout is None:
        return None
    walk = _Ros1Walk if message.channel.encoding == "ros1" else _CdrWalk
    try:
        return walk(message.data, layout, limits).rows()
    except (_UnfitError, struct.error, UnicodeDecodeError):
        return None


@lru_cache(maxsize=256)
def _layout_of(channel: Channel) -> _Layout | None:
    try:
        types = typestore_for(channel).fielddefs
    except MessageError:
        return None
    header, *rest = _split(tuple(_flat(channel.msgtype, types)))
    if len(rest) != 1 or rest[0][0] != "detections[]":
        return None
    own_header, *fields = _split(rest[0][1])
    expected = _SEQ_HEADER if channel.encoding == "ros1" else _HEADER
    if header != expected or own_header != expected or not fields or fields[0][0] != "results[]":
        return None
    has_numbers = _HYPOTHESES.get(fields[0][1])
    box, tail = _within("bbox", tuple(fields[1:]))
    if has_numbers is None or box != _BOX:
        return None
    if channel.encoding == "ros1" and _is_cloud(tail):
        return _Layout(has_numbers, "cloud")
    found = _TAILS.get(tail)
    return None if found is None else _Layout(has_numbers, found)


def _flat(msgtype: str, types: Typesdict, path: str = "") -> Iterator[tuple[str, Any]]:
    """The fields of a type in order, those of its parts with their path; a list of messages has a tuple of them."""
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


def _within(
    field: str, flat: tuple[tuple[str, Any], ...]
) -> tuple[tuple[tuple[str, Any], ...], tuple[tuple[str, Any], ...]]:
    """The first fields, as far as they belong to one part, without its name; and those behind."""
    prefix = f"{field}."
    count = next((row for row, (name, _) in enumerate(flat) if not name.startswith(prefix)), len(flat))
    return tuple((name.removeprefix(prefix), base) for name, base in flat[:count]), flat[count:]


def _split(flat: tuple[tuple[str, Any], ...]) -> tuple[Any, ...]:
    """The header, and the fields behind it."""
    header, rest = _within("header", flat)
    return header, *rest


def _is_cloud(tail: tuple[tuple[str, Any], ...]) -> bool:
    cloud, rest = _within("source_cloud", tail)
    header, *fields = _split(cloud)
    point = (("name", "string"), ("offset", "uint32"), ("datatype", "uint8"), ("count", "uint32"))
    expected = [
        ("height", "uint32"),
        ("width", "uint32"),
        ("fields[]", point),
        ("is_bigendian", "bool"),
        ("point_step", "uint32"),
        ("row_step", "uint32"),
        ("data[]", "uint8"),
        ("is_dense", "bool"),
    ]
    return not rest and header == _SEQ_HEADER and fields == expected


class _UnfitError(Exception):
    """The bytes do not fit the layout."""


class _Walk:
    """One pass over a message."""

    header_bytes: int
    """Of the numbers at the start of a header."""

    end_bytes: int
    """How many bytes may follow the message."""

    def __init__(self, data: bytes | memoryview, layout: _Layout, limits: LimitsConfig) -> None:
        self.data, self.layout, self.limits = data, layout, limits
        self.order: Literal["<", ">"] = "<"
        self.at = 0

    def to(self, size: int) -> None:
        """Go to the next multiple of `size`."""
        raise NotImplementedError

    def text(self) -> str:
        """The next string."""
        raise NotImplementedError

    def count(self) -> int:
        """The next uint32."""
        self.to(4)
        (number,) = struct.unpack_from(f"{self.order}I", self.data, self.at)
        self.at += 4
        return int(number)

    def rows(self) -> DetectionRows:
        """The content of the message.

        Raises:
            _UnfitError: the message does not end where the layout ends, or has too many parts.
            struct.error: it ends before.
            UnicodeDecodeError: a string is not UTF-8.
        """
        ids: list[str] = []
        of_box: list[int] = []
        labels: list[str] = []
        boxes_at: list[int] = []
        hypotheses_at: list[int] = []
        frame_id = self.header()
        number = self.count()
        if number > self.limits.max_boxes:
            raise _UnfitError
        left = self.limits.max_message_items - number
        for row in range(number):
            self.header()
            results = self.count()
            left -= results
            if left < 0:
                raise _UnfitError
            for _ in range(results):
                labels.append(self.label())
                self.to(8)
                of_box.append(row)
                hypotheses_at.append(self.at)
                self.at += _SCORE_AND_POSE_BYTES
            self.to(8)
            boxes_at.append(self.at)
            self.at += _BOX_BYTES
            ids.append(self.tail())
        if not 0 <= len(self.data) - self.at <= self.end_bytes:
            raise _UnfitError
        hypotheses = self.doubles(hypotheses_at, _SCORE_AND_POSE_BYTES)
        return DetectionRows(
            frame_id, self.doubles(boxes_at, _BOX_BYTES), ids, of_box, labels, hypotheses[:, 0], hypotheses[:, 8:]
        )

    def header(self) -> str:
        """Pass over a header: its frame."""
        self.to(4)
        self.at += self.header_bytes
        return self.text()

    def label(self) -> str:
        """The class of a hypothesis."""
        if not self.layout.has_numbers:
            return self.text()
        self.to(8)
        (number,) = struct.unpack_from(f"{self.order}q", self.data, self.at)
        self.at += 8
        return str(number)

    def tail(self) -> str:
        """Pass over what follows a box: its id."""
        match self.layout.tail:
            case "id":
                return self.text()
            case "tracking":
                self.at += 1
                return self.text()
            case "cloud":
                self.cloud()
        return ""

    def cloud(self) -> None:
        """Pass over a PointCloud2 of ROS 1."""
        self.header()
        self.at += 8
        for _ in range(self.count()):
            self.text()
            self.at += _POINT_FIELD_BYTES
        self.at += 1 + 8
        octets = self.count()
        self.at += octets + 1

    def doubles(self, places: list[int], size: int) -> F64:
        """(len(places), size / 8) numbers that begin at the places."""
        octets = np.frombuffer(self.data, np.uint8)
        picked: Any = octets[np.array(places, np.intp)[:, None] + np.arange(size)]
        return np.asarray(picked.view(f"{self.order}f8"), np.float64)


class _Ros1Walk(_Walk):
    header_bytes, end_bytes = 12, 0

    def to(self, size: int) -> None:
        """Fields lie without gaps."""

    def text(self) -> str:
        """The next string."""
        (length,) = struct.unpack_from("<I", self.data, self.at)
        begin = self.at + 4
        self.at = begin + length
        return bytes(self.data[begin : self.at]).decode()


class _CdrWalk(_Walk):
    header_bytes, end_bytes = 8, 3

    def __init__(self, data: bytes | memoryview, layout: _Layout, limits: LimitsConfig) -> None:
        super().__init__(data, layout, limits)
        if bytes(data[:2]) not in _ENCAPSULATIONS:
            raise _UnfitError
        self.at, self.order = 4, _ENCAPSULATIONS[bytes(data[:2])]

    def to(self, size: int) -> None:
        """Go to the next multiple of `size` behind the encapsulation."""
        self.at += (4 - self.at) % size

    def text(self) -> str:
        """The next string; its length counts the byte that ends it."""
        length = self.count()
        begin = self.at
        self.at = begin + length
        return bytes(self.data[begin : max(begin, self.at - 1)]).decode()
