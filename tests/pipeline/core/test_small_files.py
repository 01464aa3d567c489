import os
from collections.abc import Callable
from pathlib import Path

import pytest

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.small_files import read_small_text


def read(path: Path) -> str:
    return read_small_text(path, 10, "a rig file", CalibrationError)


@pytest.mark.parametrize("text", ["", "a", "0123456789", "\u00e4\r\n"])
def test_the_whole_text(tmp_path: Path, text: str) -> None:
    (tmp_path / "a").write_bytes(text.encode())
    assert read(tmp_path / "a") == text


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda _: None, "expected a rig file, found no such file"),
        (lambda path: path.write_bytes(b"x\xff"), "expected a rig file as UTF-8 text, found other bytes at 1"),
        (lambda path: path.write_bytes(b"x" * 11), "cannot be read as a rig file: expected at most .* found a larger"),
        (lambda path: path.mkdir(), "cannot be read as a rig file: Is a directory"),
        (os.mkfifo, "cannot be read as a rig file: expected a regular file, found a FIFO or a device"),
        (lambda path: path.symlink_to("/dev/zero"), "expected a regular file, found a FIFO or a device"),
    ],
)
def test_what_is_no_small_text(tmp_path: Path, make: Callable[[Path], object], problem: str) -> None:
    make(tmp_path / "a")
    with pytest.raises(CalibrationError, match=rf"/a: .*{problem}") as caught:
        read(tmp_path / "a")
    assert "\n" not in str(caught.value)
