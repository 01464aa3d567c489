"""A cache of decompressed chunks."""

from collections import OrderedDict
from collections.abc import Callable

from readers.files.decompress import Allowance

__all__ = ["ChunkCache", "detach"]

CACHE_BYTES = 64 << 20


class ChunkCache:
    """The most recently used chunks, up to a number of bytes (at least one chunk).

    Messages are read in time order but chunks are in the order of writing, so chunks that overlap in time are read
    alternately. The bound keeps memory constant even if all chunks of a recording overlap.

    Args:
        max_bytes: Bytes that are kept.
        max_loaded_bytes: Bytes that may be unpacked in total since `begin`; None for no bound.
    """

    def __init__(self, max_bytes: int = CACHE_BYTES, *, max_loaded_bytes: int | None = None) -> None:
        self._max_bytes = max_bytes
        self._max_loaded = max_loaded_bytes
        self.begin()
        self._bytes = 0
        self._chunks: OrderedDict[int, bytes] = OrderedDict()

    def begin(self) -> None:
        """Restart the count of unpacked bytes, because the recording is read once more."""
        self._allowance = None if self._max_loaded is None else Allowance(self._max_loaded)

    def get(self, position: int, load: Callable[[], bytes]) -> bytes:
        """The chunk at `position` of the file; `load` is called if it is not in the cache.

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

    def drop(self, position: int) -> None:
        """Remove the chunk at `position`, because its last message was read."""
        chunk = self._chunks.pop(position, None)
        if chunk is not None:
            self._bytes -= len(chunk)


def detach(chunk: bytes, start: int, size: int) -> bytes | memoryview:
    """The message at `start` of a chunk: a view if it is nearly all of the chunk, which the view keeps, else a copy.

    Raises:
        ValueError: the message reaches beyond the chunk.
    """
    if size < 0 or start + size > len(chunk):
        raise ValueError(f"a message of {size} bytes at {start} reaches beyond its chunk of {len(chunk)}")
    if size * 8 < len(chunk) * 7:
        return chunk[start : start + size]
    return memoryview(chunk)[start : start + size]
