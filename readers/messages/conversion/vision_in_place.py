"""Arrays of boxes of ROS 1's vision_msgs as CDR of ROS 2 Humble, without an object for every field.

What `vision` builds from decoded messages, in a tenth of its time: a hypothesis' score, pose and covariance, and a
box, are the same float64 in the same order in both, so their bytes are moved together. Truth has many such messages.
"""

import struct
from collections.abc import Callable

from pipeline.core.messages import RawMessage
from readers.messages.vision.in_place import POSED_BYTES, behind_tail
from readers.messages.vision.layouts import layout_of

__all__ = ["boxes_in_place"]

_UINT32 = struct.Struct("<I")
_INT64 = struct.Struct("<q")
_DOUBLE = struct.Struct("<d")
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
    data, out, names = bytes(message.data), bytearray(_ENCAPSULATION), dict[int, bytes]()
    try:
        at = _append_header(out, data, 0)
        (number,) = _UINT32.unpack_from(data, at)
        _append_count(out, number)
        at += 4
        for _ in range(number):
            at = _append_header(out, data, at)
            (results,) = _UINT32.unpack_from(data, at)
            at += 4
            hypotheses: list[tuple[int, int]] = []
            instances: list[int] = []
            for _ in range(results):
                (class_number,) = _INT64.unpack_from(data, at)
                at += 8
                if class_number == instance:
                    instances.append(int(_DOUBLE.unpack_from(data, at)[0]))
                else:
                    hypotheses.append((class_number, at))
                at += POSED_BYTES
            _append_count(out, len(hypotheses))
            for class_number, place in hypotheses:
                if class_number not in names:
                    names[class_number] = name_of(class_number).encode()
                _append_text(out, names[class_number])
                _append_doubles(out, data[place : place + POSED_BYTES])
            _append_doubles(out, data[at : at + 8 * layout.numbers])
            at = behind_tail(data, at + 8 * layout.numbers, layout.tail)[0]
            _append_text(out, b"%d" % instances[0] if instances and instances[0] >= 0 else b"")
    except (struct.error, ValueError, OverflowError):  # also of texts, and of instances that are no numbers
        return None
    return bytes(out) if at == len(data) else None


def _append_header(out: bytearray, data: bytes, at: int) -> int:
    """A header without `seq`; where it ends in ROS 1."""
    sec, nanosec = _TIME.unpack_from(data, at + 4)
    (length,) = _UINT32.unpack_from(data, at + 12)
    frame_id = data[at + 16 : at + 16 + length]
    frame_id.decode()
    out += bytes(-len(out) & 3)
    out += _STAMP.pack(*divmod(sec * 10**9 + nanosec, 10**9))
    _append_text(out, frame_id)
    return at + 16 + int(length)


def _append_count(out: bytearray, count: int) -> None:
    out += bytes(-len(out) & 3)
    out += _UINT32.pack(count)


def _append_text(out: bytearray, encoded: bytes) -> None:
    _append_count(out, len(encoded) + 1)
    out += encoded
    out.append(0)


def _append_doubles(out: bytearray, numbers: bytes) -> None:
    out += bytes((len(_ENCAPSULATION) - len(out)) & 7)
    out += numbers
