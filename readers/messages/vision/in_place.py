"""Reads arrays of boxes of the known layouts in place, without an object for every field.

ROS 1 packs fields without gaps (wiki.ros.org/msg). CDR aligns each number to its size, counted from the end of a
four-byte encapsulation whose second byte says which end comes first (OMG formal/02-06-51, 9.3; DDSI-RTPS 10.2).
Positions are walked over in Python, numbers are gathered by numpy at the end.
"""

import struct
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import LimitsConfig
from readers.messages.vision.layouts import BoxLayout, Tail, layout_of

__all__ = ["POSED_BYTES", "BoxRows", "behind_tail", "rows_in_place"]


class BoxRows(NamedTuple):
    """The content of an array of boxes, as recorded.

    Attributes:
        frame_id: As recorded.
        boxes: (N, 10) float64 in space: position x, y, z; orientation x, y, z, w; size x, y, z. (N, 5) in images:
            centre x, y; angle; size x, y.
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


POSED_BYTES = 8 * (1 + 7 + 36)
"""Score, pose and covariance of a hypothesis."""

_POINT_FIELD_BYTES = 4 + 1 + 4
"""Offset, datatype and count of a point's field, behind its name."""

_ENCAPSULATIONS: dict[bytes, Literal["<", ">"]] = {b"\0\0": ">", b"\0\1": "<"}
_UINT32 = {order: struct.Struct(f"{order}I").unpack_from for order in ("<", ">")}
_INT64 = {order: struct.Struct(f"{order}q").unpack_from for order in ("<", ">")}


class _UnfitError(Exception):
    """The bytes do not fit the layout."""


@dataclass(slots=True)
class _Places:
    """Where the parts of a message lie."""

    frame_id: bytes = b""
    boxes: list[int] = field(default_factory=list)
    ids: list[bytes] = field(default_factory=list)
    of_box: list[int] = field(default_factory=list)
    labels: list[bytes] = field(default_factory=list)
    hypotheses: list[int] = field(default_factory=list)


def rows_in_place(message: RawMessage, limits: LimitsConfig) -> BoxRows | None:
    """The content of a message of a known layout; None if it has another, or does not fit it.

    The caller then decodes it by its definition, which says what is wrong with it.
    """
    layout = None if message.problem else layout_of(message.channel)
    if layout is None:
        return None
    data = bytes(message.data)
    try:
        if message.channel.encoding == "ros1":
            order: Literal["<", ">"] = "<"
            found = _walk_ros1(data, layout, limits)
        else:
            if data[:2] not in _ENCAPSULATIONS:
                return None
            order = _ENCAPSULATIONS[data[:2]]
            found = _walk_cdr(data, layout, limits, order)
        hypotheses = _doubles(data, found.hypotheses, POSED_BYTES // 8, order)
        return BoxRows(
            _text(found.frame_id),
            _doubles(data, found.boxes, layout.numbers, order),
            [_text(id_) for id_ in found.ids],
            found.of_box,
            [_text(label) for label in found.labels],
            hypotheses[:, 0],
            hypotheses[:, 8:],
        )
    except (_UnfitError, struct.error, UnicodeDecodeError):
        return None


def _walk_cdr(data: bytes, layout: BoxLayout, limits: LimitsConfig, order: Literal["<", ">"]) -> _Places:
    """Where the parts of a CDR message lie.

    Raises:
        _UnfitError: the message does not end where the layout ends, or has too many parts.
        struct.error: it ends before.
    """
    found, uint32, int64 = _Places(), _UINT32[order], _INT64[order]
    at = 4 + 8  # encapsulation, stamp
    (length,) = uint32(data, at)
    at += 4 + length
    found.frame_id = data[at - length : at - 1]
    at += -at & 3
    (number,) = uint32(data, at)
    at += 4
    left = limits.max_message_items - number
    if number > limits.max_boxes or left < 0:
        raise _UnfitError
    for row in range(number):
        at += (-at & 3) + 8
        (length,) = uint32(data, at)
        at += 4 + length
        at += -at & 3
        (results,) = uint32(data, at)
        at += 4
        left -= results
        if left < 0:
            raise _UnfitError
        for _ in range(results):
            if layout.has_numbers:
                at += (4 - at) & 7
                found.labels.append(b"%d" % int64(data, at)[0])
                at += 8
            else:
                at += -at & 3
                (length,) = uint32(data, at)
                at += 4 + length
                found.labels.append(data[at - length : at - 1])
            at += (4 - at) & 7
            found.of_box.append(row)
            found.hypotheses.append(at)
            at += POSED_BYTES
        at += (4 - at) & 7
        found.boxes.append(at)
        at += 8 * layout.numbers
        if layout.tail == "none":
            found.ids.append(b"")
            continue
        at += layout.tail == "tracking"
        at += -at & 3
        (length,) = uint32(data, at)
        at += 4 + length
        found.ids.append(data[at - length : at - 1])
    if not 0 <= len(data) - at <= 3:
        raise _UnfitError
    return found


def _walk_ros1(data: bytes, layout: BoxLayout, limits: LimitsConfig) -> _Places:
    """Where the parts of a ROS 1 message lie; errors as of `_walk_cdr`."""
    found, uint32, int64 = _Places(), _UINT32["<"], _INT64["<"]
    at = 12  # seq, stamp
    (length,) = uint32(data, at)
    at += 4 + length
    found.frame_id = data[at - length : at]
    (number,) = uint32(data, at)
    at += 4
    left = limits.max_message_items - number
    if number > limits.max_boxes or left < 0:
        raise _UnfitError
    for row in range(number):
        at += 12
        (length,) = uint32(data, at)
        at += 4 + length
        (results,) = uint32(data, at)
        at += 4
        left -= results
        if left < 0:
            raise _UnfitError
        for _ in range(results):
            if layout.has_numbers:
                found.labels.append(b"%d" % int64(data, at)[0])
                at += 8
            else:
                (length,) = uint32(data, at)
                at += 4 + length
                found.labels.append(data[at - length : at])
            found.of_box.append(row)
            found.hypotheses.append(at)
            at += POSED_BYTES
        found.boxes.append(at)
        at += 8 * layout.numbers
        at, id_ = behind_tail(data, at, layout.tail)
        found.ids.append(id_)
    if len(data) != at:
        raise _UnfitError
    return found


def behind_tail(data: bytes, at: int, tail: Tail) -> tuple[int, bytes]:
    """Where what follows a box ends in ROS 1, and the box's id."""
    uint32 = _UINT32["<"]
    if tail == "none":
        return at, b""
    if tail in ("id", "tracking"):
        at += tail == "tracking"
        (length,) = uint32(data, at)
        return at + 4 + length, data[at + 4 : at + 4 + length]
    (length,) = uint32(data, at + 12)  # behind seq and stamp
    at += 12 + 4 + length + 8  # height, width
    (count,) = uint32(data, at)
    at += 4
    if tail == "image":  # `count` is the length of the encoding
        at += count + 1 + 4  # is_bigendian, step
        (length,) = uint32(data, at)
        return at + 4 + length, b""
    for _ in range(count):
        (length,) = uint32(data, at)
        at += 4 + length + _POINT_FIELD_BYTES
    at += 1 + 4 + 4  # is_bigendian, point_step, row_step
    (length,) = uint32(data, at)
    return at + 4 + length + 1, b""  # is_dense


@lru_cache(maxsize=4096)
def _text(encoded: bytes) -> str:
    return encoded.decode()


def _doubles(data: bytes, places: list[int], count: int, order: Literal["<", ">"]) -> F64:
    """(len(places), count) numbers that begin at the places."""
    picked = b"".join([data[place : place + 8 * count] for place in places])
    if len(picked) != 8 * count * len(places):
        raise _UnfitError
    return np.frombuffer(picked, f"{order}f8").reshape(-1, count).astype(np.float64, copy=False)
