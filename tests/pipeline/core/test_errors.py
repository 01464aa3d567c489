"""Short memory is told apart from everything else."""

import errno

import cv2
import numpy as np
import pytest

from lidcam.pipeline.core.errors import (
    LidcamError,
    RecordingError,
    ShortMemoryError,
    is_short_memory,
    short_memory_told,
)


def opencv(code: int) -> cv2.error:
    err = cv2.error("failed")
    err.code = code
    return err


@pytest.mark.parametrize(
    ("err", "expected"),
    [
        (MemoryError(), True),
        (ShortMemoryError("x"), True),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), True),
        (OSError(errno.ENOSPC, "out of memory"), False),
        (opencv(-4), True),
        (opencv(-215), False),
        (RuntimeError("could not allocate ZSTD_DCtx: Out of memory"), True),
        (RuntimeError("can't start new thread"), True),
        (RuntimeError("LZ4F_decompress failed"), False),
        (RecordingError("a topic called out of memory"), False),
        (ValueError("x"), False),
    ],
)
def test_what_is_short_memory(err: Exception, expected: bool) -> None:
    assert is_short_memory(err) is expected


def test_numpy_says_how_much() -> None:
    with (
        pytest.raises(ShortMemoryError, match=r"not enough memory to read a.bag: 8.00 EiB could not be had; end other"),
        short_memory_told("read a.bag"),
    ):
        np.empty(2**60 - 1, np.int64)


def test_where_it_ran_short_is_kept() -> None:
    err = MemoryError()
    err.add_note("in stage combine")
    with pytest.raises(ShortMemoryError) as caught, short_memory_told("go on"):
        raise err
    assert caught.value.__notes__ == ["in stage combine"]
    assert str(caught.value).startswith("not enough memory to go on; ")


@pytest.mark.parametrize("err", [ValueError("x"), RecordingError("y"), LidcamError("z")])
def test_all_else_passes(err: Exception) -> None:
    with pytest.raises(type(err)) as caught, short_memory_told("go on"):
        raise err
    assert caught.value is err
