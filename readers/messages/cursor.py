"""Single fields from the bytes of a message that has not been decoded.

ROS 1 packs fields without gaps (wiki.ros.org/msg). CDR aligns each number to its size, counted from the end of a
four-byte encapsulation whose second byte says which end comes first (OMG formal/02-06-51, 9.3; DDSI-RTPS 10.2).
"""

import struct

_UINT32 = {"<": struct.Struct("<I"), ">": struct.Struct(">I")}
_ENCAPSULATION_BYTES = 4


class Cursor:
    """A place in a message that is serialised as `ros1` or `cdr`.

    Attributes:
        order: Byte order of numbers, `<` or `>`.
        at: Position of the next byte, counted from the start of `data`.
    """

    __slots__ = ("_data", "_is_aligned", "at", "order")

    def __init__(self, data: bytes | memoryview, encoding: str) -> None:
        self._data, self._is_aligned = data, encoding == "cdr"
        self.at = _ENCAPSULATION_BYTES if self._is_aligned else 0
        self.order = ">" if self._is_aligned and len(data) > 1 and not data[1] & 1 else "<"

    def skip(self, size: int, count: int = 1) -> None:
        """Pass over numbers of `size` bytes each."""
        if count:
            self._align(size)
        self.at += size * count

    def uint32(self) -> int:
        """The next number, also the length of a list.

        Raises:
            struct.error: the message ends before it.
        """
        self._align(4)
        (value,) = _UINT32[self.order].unpack_from(self._data, self.at)
        self.at += 4
        return int(value)

    def string(self) -> str:
        """The next string.

        Raises:
            struct.error: the message ends before its length.
            UnicodeDecodeError: it is not UTF-8.
        """
        length = self.uint32()
        encoded = bytes(self._data[self.at : self.at + length])
        self.at += length
        return encoded.rstrip(b"\0").decode()

    def _align(self, size: int) -> None:
        if self._is_aligned:
            self.at += (_ENCAPSULATION_BYTES - self.at) % size
