import pytest

from lidcam.readers.files.chunked import detach


@pytest.mark.parametrize(("start", "size"), [(0, 101), (100, 1), (0, -1)])
def test_messages_beyond_the_chunk(start: int, size: int) -> None:
    with pytest.raises(ValueError, match="beyond its chunk"):
        detach(bytes(100), start, size)
