"""Objects on their way between processes, or through a file: pickled, with large arrays and messages beside the pickle.

What is large is written from where it lies, and read to where it stays: no copies but those of the system (PEP 574).
Small arrays are pickled, so that keeping one does not keep a large buffer.
"""

import io
import os
import pickle
import socket
import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

BESIDE_BYTES = 1 << 14
"""Smallest size of an array that travels beside the pickle."""

MAX_PARTS = 512
"""Parts that are handed to the system at once; Linux takes 1024."""

COUNT = struct.Struct("<Q")

Fill = Callable[[memoryview], int | None]
"""Reads into the beginning of a buffer; returns the number of bytes."""

HELD_BYTES = 1 << 22
"""Size of the system's buffer: a frame, so that the sender need not wait for a process that is at work on a stage."""


def connected() -> tuple[socket.socket, socket.socket]:
    """Both ends of a connection of two processes."""
    pair = socket.socketpair()
    for end in pair:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, HELD_BYTES)
    return pair


def send(connection: socket.socket, value: object) -> None:
    """Send an object; waits until the other side has taken it, but for what the system holds.

    Raises OSError if the other side is gone, and what the object raises when it is pickled: then nothing was sent.
    """
    _write_all(connection.sendmsg, _parts(value))


def receive(connection: socket.socket) -> object:
    """The next object that the other side sent.

    Raises:
        EOFError, OSError: the other side is gone.
    """
    return _value(lambda buffer: connection.recv_into(buffer, 0, socket.MSG_WAITALL))


def dump(value: object, file: io.FileIO) -> None:
    """Write an object at the current position of a file.

    Raises OSError if it cannot be written, of which a part may have been, and what the object raises when it is
    pickled: then nothing was written.
    """
    _write_all(partial(os.writev, file.fileno()), _parts(value))


def load(file: io.FileIO) -> object:
    """The object that `dump` wrote at the current position of a file, which only this process can write.

    Raises EOFError if the file ends before the object does, and OSError if it cannot be read.
    """
    return _value(file.readinto)


def _parts(value: object) -> list[memoryview]:
    stream = io.BytesIO()
    large: list[memoryview] = []

    def is_pickled(buffer: pickle.PickleBuffer) -> bool:
        view = buffer.raw()
        if view.nbytes < BESIDE_BYTES:
            return True
        large.append(view)
        return False

    _Pickler(stream, protocol=5, buffer_callback=is_pickled).dump(value)
    parts = [stream.getbuffer(), *large]
    sizes = struct.pack(f"<{1 + len(parts)}Q", len(parts), *(part.nbytes for part in parts))
    return [memoryview(sizes), *parts]


def _value(fill: Fill) -> object:
    (count,) = COUNT.unpack(_read(fill, COUNT.size))
    sizes = struct.unpack(f"<{count}Q", _read(fill, COUNT.size * count))
    stream, *large = (_read(fill, size) for size in sizes)
    return pickle.loads(stream, buffers=large)  # noqa: S301  # of this process, one that it has started, or its parent


def arrived(value: object) -> object:
    """A value as the other side would receive it."""
    return pickle.loads(pickle.dumps(value))  # noqa: S301  # made in this line


class _Pickler(pickle.Pickler):
    """Takes views of memory, too, which messages of recordings are."""

    def reducer_override(self, obj: object) -> Any:
        if isinstance(obj, memoryview):
            return _read_only, (pickle.PickleBuffer(obj),)
        return NotImplemented


def _read_only(buffer: bytes | bytearray | memoryview) -> memoryview:
    return memoryview(buffer).toreadonly()


def _write_all(write: Callable[[Sequence[memoryview]], int], parts: Sequence[memoryview]) -> None:
    left = [part for part in parts if part.nbytes]
    while left:
        written = write(left[:MAX_PARTS])
        while left and written >= left[0].nbytes:
            written -= left.pop(0).nbytes
        if written:
            left[0] = left[0].cast("B")[written:]


def _read(fill: Fill, size: int) -> memoryview:
    buffer = np.empty(size, np.uint8).data  # unlike a bytearray, not filled with zeros first
    filled = 0
    while filled < size:
        count = fill(buffer[filled:])
        if not count:
            raise EOFError("the process at the other end is gone, or the file ends")
        filled += count
    return buffer
