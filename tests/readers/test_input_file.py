"""What tells an input from others."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from hashlib import sha256
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.input_file import (
    BLOCK_BYTES,
    END_BYTES,
    STEP_BYTES,
    InputFile,
    InputFiles,
    OpenedFile,
    read_input_file,
    read_opened_files,
)
from lidcam.readers.location import Location, RemotePath

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


# --- files of a run


@pytest.fixture
def opened() -> Iterator[Callable[[Sequence[Location]], list[OpenedFile]]]:
    """Opens files as a recording does."""
    with ExitStack() as stack:
        yield lambda paths: [
            OpenedFile(
                path, stack.enter_context(path.open("rb")) if isinstance(path, Path) and path.is_file() else None
            )
            for path in paths
        ]


Opened = Callable[[Sequence[Location]], list[OpenedFile]]


@pytest.mark.parametrize(
    ("sizes", "shares"),
    [
        ((), (1.0,)),
        ((BLOCK_BYTES,), (-1.0, 7.0)),
        ((STEP_BYTES + 1,), ()),
        ((0, STEP_BYTES, 3, 0, 7), (0.0, 0.3, 0.3, 0.2, 0.9)),
    ],
)
def test_the_same_as_file_by_file(
    tmp_path: Path, sizes: tuple[int, ...], shares: tuple[float, ...], opened: Opened
) -> None:
    paths = [tmp_path / str(row) for row in range(len(sizes))]
    for path, size in zip(paths, sizes, strict=True):
        path.write_bytes(np.random.default_rng(size).bytes(size))
    with closing(InputFiles(opened(paths), {}, with_checksums=True)) as files:
        assert files.unread == tuple(map(InputFile.unread, paths))
        for share in shares:
            files.read_up_to(share)
        assert files.finish() == files.finish() == tuple(map(read_input_file, paths))


def test_a_file_on_a_server_among_them(tmp_path: Path, opened: Opened) -> None:
    (tmp_path / "drive.bag").write_bytes(b"content")
    paths: list[Location] = [RemotePath("https://host/drive.mcap", FACTS), tmp_path / "drive.bag"]
    files = opened(paths)
    assert read_opened_files(files) == tuple(map(read_input_file, paths))
    with closing(InputFiles(files, {}, with_checksums=False)) as known:
        assert known.finish() == tuple(map(InputFile.unread, paths))


def replaced(path: Path) -> None:
    (path.parent / "new").write_bytes(b"new")
    (path.parent / "new").replace(path)


def appended(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"more")


CHANGES: dict[str, Callable[[Path], object]] = {
    "replaced": replaced,
    "appended": appended,
    "cut": lambda path: os.truncate(path, 7),
}


@pytest.mark.parametrize("with_checksums", [True, False])
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_file_that_is_changed_meanwhile(
    tmp_path: Path, change: str, share: float, with_checksums: bool, opened: Opened
) -> None:
    """Another file in its place does not matter, as the one that was opened is read; writing to it does."""
    paths = [tmp_path / "first", tmp_path / "second"]
    for path in paths:
        path.write_bytes(bytes(STEP_BYTES))
    before = tuple(map(read_input_file if with_checksums else InputFile.unread, paths))
    with closing(InputFiles(opened(paths), {}, with_checksums=with_checksums)) as files:
        files.read_up_to(share)
        CHANGES[change](paths[1])
        first, second = files.finish()
    written = change in {"appended", "cut"}
    assert first == before[0]
    assert second == (before[1]._replace(sha256=None, is_changed=True) if written else before[1])
    if written:
        assert (second.provenance, second.as_read) == (
            {"name": "second", "size": str(STEP_BYTES)},
            {"changed": "while it was read"},
        )


def test_a_file_that_cannot_be_read_to_its_end(tmp_path: Path, opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "drive.bag"
    path.write_bytes(bytes(3 * STEP_BYTES))
    monkeypatch.setattr("lidcam.readers.input_file.read_at", Mock(side_effect=OSError(5, "Input/output error")))
    with closing(InputFiles(opened([path]), {}, with_checksums=True)) as files:
        files.read_up_to(1.0)
        with pytest.raises(RecordingError, match=r"drive.bag: expected a file that can be read: Input/output error"):
            files.finish()


def test_a_fingerprint_without_reading_all_of_it(tmp_path: Path, opened: Opened) -> None:
    paths = [tmp_path / "first", tmp_path / "second"]
    content = bytes(4 * END_BYTES)

    def fingerprint(first: bytes, second: bytes) -> str:
        for path, text in zip(paths, (first, second), strict=True):
            path.write_bytes(text)
        with closing(InputFiles(opened(paths), {}, with_checksums=False)) as files:
            return files.fingerprint()

    plain = fingerprint(content, content)
    assert plain == fingerprint(content, content)
    others = [fingerprint(content, b"\1" + content[1:]), fingerprint(content, content[1:] + b"\1")]
    others += [fingerprint(content[1:] + b"\1", content), fingerprint(content[1:], content), fingerprint(b"", b"")]
    assert len({plain, *others}) == 6
