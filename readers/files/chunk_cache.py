"""Decompressed chunks, kept while they are likely to be read again."""

from collections import OrderedDict
from collections.abc import Callable

from readers.files.decompress import Allowance

__all__ = ["ChunkCache", "detach"]

CACHE_BYTES = 64 << 20


class ChunkCache:
    """The chunks used last, up to a number of bytes (at least one).

    Messages come in time order while chunks lie in the order of writing: neighbours overlap in time and are needed
    by turns. The bound keeps the memory of a recording whose chunks all overlap from growing with its length.

    Args:
        max_bytes: What is kept.
        max_loaded_bytes: What may be unpacked in all since `begin`; None for no bound.
    """

    def __init__(self, max_bytes: int = CACHE_BYTES, *, max_loaded_bytes: int | None = None) -> None:
        self._max_bytes = max_bytes
        self._most_loaded = max_loaded_bytes
        self.begin()
        self._bytes = 0
        self._chunks: OrderedDict[int, bytes] = OrderedDict()

    def begin(self) -> None:
        """Count what is unpacked anew: the recording is read once more."""
        self._allowance = None if self._most_loaded is None else Allowance(self._most_loaded)

    def get(self, position: int, load: Callable[[], bytes]) -> bytes:
        """The chunk at `position` of the file; `load` is called where it is not kept.

        Raises:
            ValueError: more was unpacked than is allowed.
        """
        if position in self._chunks:
            self._chunks.move_to_end(position)
            return self._chunks[position]
        if self._allowance is not None:
            self._allowance.take(0)
        chunk = load()
        if self._allowance is not None:
            self._allowance.take(len(chunk))
        self._chunks[position] = chunk
        self._bytes += len(chunk)
        while self._bytes > self._max_bytes and len(self._chunks) > 1:
            self._bytes -= len(self._chunks.popitem(last=False)[1])
        return chunk

    def holds(self, position: int) -> bool:
        """Whether the chunk at `position` is kept."""
        return position in self._chunks

    def drop(self, position: int) -> None:
        """Forget the chunk at `position`: its last message was read."""
        chunk = self._chunks.pop(position, None)
        if chunk is not None:
            self._bytes -= len(chunk)


def detach(chunk: bytes, start: int, size: int) -> bytes | memoryview:
    """The message at `start` of a chunk: without copying where that does not hold much else in memory.

    A view keeps its whole chunk alive, so a message much smaller than its chunk is copied.

    Raises:
        ValueError: the message reaches beyond the chunk.
    """
    if size < 0 or start + size > len(chunk):
        raise ValueError(f"a message of {size} bytes at {start} reaches beyond its chunk of {len(chunk)}")
    if size * 4 < len(chunk):
        return chunk[start : start + size]
    return memoryview(chunk)[start : start + size]
