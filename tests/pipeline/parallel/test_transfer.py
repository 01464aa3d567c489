import socket
import tempfile
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.parallel.transfer import BESIDE_BYTES, HELD_BYTES, MAX_PARTS, connected, dump, load, receive, send


@pytest.fixture(scope="module")
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    one, other = connected()
    with one, other:
        yield one, other


def sent(value: object, pair: tuple[socket.socket, socket.socket]) -> Any:
    thread = threading.Thread(target=send, args=(pair[0], value))
    thread.start()
    try:
        return receive(pair[1])
    finally:
        thread.join()


def kept(value: object) -> Any:
    """A value that was read from a file, where another one lies before it."""
    with tempfile.TemporaryFile(buffering=0) as file:
        dump("another", file)
        at = file.tell()
        dump(value, file)
        file.seek(at)
        return load(file)


SIZES = st.sampled_from([0, 1, 100, BESIDE_BYTES - 1, BESIDE_BYTES, 300_000])


@given(sizes=st.lists(SIZES, max_size=6), dtype=st.sampled_from(["u1", "<f8", ">i2"]), view=st.booleans())
@settings(max_examples=30)
def test_values_arrive_as_they_were(
    pair: tuple[socket.socket, socket.socket], sizes: list[int], dtype: str, view: bool
) -> None:
    arrays = [np.arange(size).astype(dtype) for size in sizes]
    messages = [memoryview(array.tobytes()) if view else array.tobytes() for array in arrays]
    columns = [np.stack([array, array], 1)[:, 1] for array in arrays]  # not contiguous
    for found in (sent(value := (arrays, messages, columns, arrays), pair), kept(value)):
        _check(found, arrays, messages, columns, view=view)


def _check(
    found: Any, arrays: list[Any], messages: list[bytes | memoryview], columns: list[Any], *, view: bool
) -> None:
    for array, message, column, one, text, strip in zip(arrays, messages, columns, *found[:3], strict=True):
        np.testing.assert_array_equal(one, array, strict=True)
        np.testing.assert_array_equal(strip, column, strict=True)
        assert bytes(text) == bytes(message)
        assert one.flags.writeable
        if view:
            assert isinstance(text, memoryview)
            assert text.readonly
    assert all(one is again for one, again in zip(found[0], found[3], strict=True))


def test_more_arrays_than_the_system_takes_at_once(pair: tuple[socket.socket, socket.socket]) -> None:
    arrays = [np.full(BESIDE_BYTES, i % 256, np.uint8) for i in range(MAX_PARTS + 3)]
    for one, other in zip(sent(arrays, pair), arrays, strict=True):
        np.testing.assert_array_equal(one, other)


def test_nobody_at_the_other_end() -> None:
    one, other = socket.socketpair()
    with one:
        other.close()
        with pytest.raises(OSError, match="pipe"):
            send(one, np.zeros(10_000_000))
        with pytest.raises(EOFError):
            receive(one)


def test_the_other_end_dies_in_the_middle() -> None:
    one, other = socket.socketpair()
    with one:
        with other:
            other.send(b"\2" + bytes(7) + bytes(3))
        with pytest.raises(EOFError):
            receive(one)


@pytest.mark.parametrize("size", [0, 1, 8, 30, 90_000])
def test_a_file_that_ends_before_the_value(size: int) -> None:
    with tempfile.TemporaryFile(buffering=0) as file:
        dump(np.zeros(100_000, np.uint8), file)
        file.truncate(size)
        file.seek(0)
        with pytest.raises(EOFError):
            load(file)


def test_what_cannot_be_pickled_leaves_nothing_behind(pair: tuple[socket.socket, socket.socket]) -> None:
    with pytest.raises(Exception, match="pickle"):
        send(pair[0], [np.zeros(10), lambda: 0])
    assert sent("next", pair) == "next"


def test_a_frame_is_sent_without_waiting_for_the_other_end() -> None:
    one, other = connected()
    with one, other:
        if one.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) < HELD_BYTES:
            pytest.skip("the system holds less")
        one.setblocking(False)  # to wait would be an error
        send(one, np.full(HELD_BYTES // 2, 7, np.uint8))
        found = receive(other)
    assert isinstance(found, np.ndarray)
    assert (found == 7).all()
