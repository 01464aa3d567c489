"""Arrays of boxes of ROS 1's vision_msgs as CDR of ROS 2 Humble, without an object for every field.

What `vision` builds from decoded messages, in a tenth of its time: a hypothesis' score, pose and covariance, and a
box, are the same float64 in the same order in both, so their bytes are moved together. Truth has many such messages.
"""

import struct
from collections.abc import Callable
from functools import lru_cache

from pipeline.core.messages import RawMessage
from readers.messages.vision.in_place import POSED_BYTES, behind_tail
from readers.messages.vision.layouts import layout_of

__all__ = ["boxes_in_place"]

_uint32, _pack_uint32 = struct.Struct("<I").unpack_from, struct.Struct("<I").pack
_int64, _double = struct.Struct("<q").unpack_from, struct.Struct("<d").unpack_from
_TIME, _STAMP = struct.Struct("<II"), struct.Struct("<iI")  # of ROS 1 and of ROS 2
_ENCAPSULATION = b"\0\1\0\0"  # little-endian CDR; numbers are aligned from its end


def boxes_in_place(message: RawMessage, name_of: Callable[[int], str], instance: int) -> bytes | None:
    """The CDR of an array of boxes of ROS 1; None if its layout is another, or it does not fit it.

    The caller then decodes it by its definition, which says what is wrong with it.

    Args:
        message: In ROS 1's encoding.
        name_of: The class that a number stands for.
        instance: The number of hypotheses whose score is no score, but says which object it is.
    """
    layout = layout_of(message.channel)
    if layout is None or not layout.has_numbers or layout.tail not in ("cloud", "image"):
        return None
    data, out = bytes(message.data), bytearray(_ENCAPSULATION)
    try:
        at = _append_header(out, data, 0)
        (number,) = _uint32(data, at)
        _append_count(out, number)
        at += 4
        for _ in range(number):
            at = _append_header(out, data, at)
            (results,) = _uint32(data, at)
            at += 4
            _append_count(out, results)
            place, instances = len(out), []
            for _ in range(results):
                (class_number,) = _int64(data, at)
                at += 8
                if class_number == instance:
                    instances.append(int(_double(data, at)[0]))
                else:
                    out += _before_score(name_of(class_number), len(out) % 8)
                    out += data[at : at + POSED_BYTES]
                at += POSED_BYTES
            if instances:
                out[place - 4 : place] = _pack_uint32(results - len(instances))
            out += bytes((len(_ENCAPSULATION) - len(out)) & 7)
            out += data[at : at + 8 * layout.numbers]
            at = behind_tail(data, at + 8 * layout.numbers, layout.tail)[0]
            out += _text(b"%d" % instances[0] if instances and instances[0] >= 0 else b"")  # behind whole numbers of 8
    except (struct.error, ValueError, OverflowError):  # also of texts, and of instances that are no numbers
        return None
    return bytes(out) if at == len(data) else None


def _append_header(out: bytearray, data: bytes, at: int) -> int:
    """A header without `seq`; where it ends in ROS 1."""
    (length,) = _uint32(data, at + 12)
    end = at + 16 + int(length)
    out += bytes(-len(out) & 3)
    out += _header(data[at + 4 : end])
    return end


@lru_cache(maxsize=64)  # of the boxes in an array it is mostly that of the array
def _header(recorded: bytes) -> bytes:
    """A header of ROS 2 from one of ROS 1 without `seq`."""
    sec, nanosec = _TIME.unpack_from(recorded)
    frame_id = recorded[12:]
    frame_id.decode()
    return _STAMP.pack(*divmod(sec * 10**9 + nanosec, 10**9)) + _text(frame_id)


@lru_cache(maxsize=4096)
def _before_score(name: str, place: int) -> bytes:
    """A hypothesis up to its score, behind bytes whose number is `place` modulo 8."""
    before = bytes(-place & 3) + _text(name.encode())
    return before + bytes((len(_ENCAPSULATION) - place - len(before)) & 7)


def _append_count(out: bytearray, count: int) -> None:
    out += bytes(-len(out) & 3)
    out += _pack_uint32(count)


def _text(encoded: bytes) -> bytes:
    return _pack_uint32(len(encoded) + 1) + encoded + b"\0"
