import pytest

from lidcam.readers.files.chunked import ChunkCache, detach


def test_cache_keeps_the_chunks_used_last() -> None:
    loaded = []
    cache = ChunkCache(max_bytes=25)

    def get(position: int) -> bytes:
        def load() -> bytes:
            loaded.append(position)
            return bytes([position]) * 10

        return cache.get(position, load)

    assert [get(p)[0] for p in (1, 2, 1, 3, 1, 2)] == [1, 2, 1, 3, 1, 2]
    assert loaded == [1, 2, 3, 2]  # 3 pushed 2 out, not 1, which was used after it
    cache.drop(2)
    cache.drop(99)
    get(2)
    assert loaded == [1, 2, 3, 2, 2]


@pytest.mark.parametrize(("start", "size"), [(0, 101), (100, 1), (0, -1)])
def test_messages_beyond_the_chunk(start: int, size: int) -> None:
    with pytest.raises(ValueError, match="beyond its chunk"):
        detach(bytes(100), start, size)
