"""What tells an input from others."""

from hashlib import sha256
from pathlib import Path

import pytest

from pipeline.core.errors import RecordingError
from readers.input_file import InputFile, read_input_file
from readers.location import RemotePath

FACTS = (("size", "1234"), ("etag", '"x"'))


def test_a_file_has_its_size_and_checksum(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    path.write_bytes(b"content")
    digest = sha256(b"content").hexdigest()
    found = read_input_file(path)
    assert found.tree() == {"path": str(path), "bytes": 7, "sha256": digest}
    assert found.provenance == {"name": "drive.bag", "sha256": digest}
    unread = InputFile.unread(path)
    assert unread.tree() == {"path": str(path), "bytes": 7, "sha256": None}
    assert unread.provenance == {"name": "drive.bag", "size": "7"}


def test_a_folder_that_is_not_read(tmp_path: Path) -> None:
    assert InputFile.unread(tmp_path).tree() == {"path": str(tmp_path), "bytes": None, "sha256": None}
    assert InputFile.unread(tmp_path).provenance == {"name": tmp_path.name}


def test_a_file_on_a_server_is_not_read() -> None:
    found = read_input_file(RemotePath("https://me:secret@host/a/drive.mcap?signature=x", FACTS))
    shown = "https://host/a/drive.mcap?..."
    assert found.tree() == {"path": shown, "bytes": 1234, "sha256": None, "etag": '"x"'}
    assert found.provenance == {"name": "drive.mcap", "url": shown, "size": "1234", "etag": '"x"'}


@pytest.mark.parametrize("size", ["", "unknown", "-1"])
def test_a_server_that_says_no_size(size: str) -> None:
    assert InputFile.unread(RemotePath("s3://bucket/drive.mcap", (("size", size),))).bytes is None


def test_a_file_that_is_gone(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"drive.bag: expected a file that can be read: No such file"):
        read_input_file(tmp_path / "drive.bag")
