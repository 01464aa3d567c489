"""Inputs identified by size and checksum."""

import math
from collections.abc import Generator, Sequence
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.core.errors import RecordingError
from pipeline.parallel.background import Background
from readers.location import Location, RemotePath

__all__ = ["InputFile", "InputFiles", "read_input_file"]

END_BYTES = 1 << 16
"""Bytes read at the beginning and at the end of a file for a fingerprint: the first clouds or images, and the index."""

BLOCK_BYTES, STEP_BYTES = 1 << 20, 1 << 22
"""Bytes read at once for a checksum; fewer are not worth waking a thread."""


class InputFile(NamedTuple):
    """An input file.

    Attributes:
        path: As it was given, without credentials; a ROS 2 folder and a split recording are the files that they hold.
        name: Name of the file.
        bytes: Its size; None where nothing says it: of a folder, and where a server does not.
        sha256: Digest of its content, hexadecimal; of an evaluation folder, of the names and sizes of its files. None
            where it was not read as a whole: of a file on a server, and where only a part was processed.
        server: Facts that the server gives: `size`, `etag`, `last_modified`.
    """

    path: str
    name: str
    bytes: int | None = None
    sha256: str | None = None
    server: tuple[tuple[str, str], ...] = ()

    @classmethod
    def unread(cls, path: Location) -> "InputFile":
        """Only what its path says, and its size: that of the file, or what the server said when it was opened."""
        if isinstance(path, RemotePath):
            size = dict(path.facts).get("size", "")
            return cls(str(path), path.name, int(size) if size.isdecimal() else None, None, path.facts)
        return cls(str(path), path.name, path.stat().st_size if path.is_file() else None)

    @property
    def provenance(self) -> dict[str, str]:
        """The record of it in a result: not where it lay."""
        if self.sha256 is not None:
            return {"name": self.name, "sha256": self.sha256}
        if "://" in self.path:
            return {"name": self.name, "url": self.path, **dict(self.server)}
        return {"name": self.name} | ({} if self.bytes is None else {"size": str(self.bytes)})

    def tree(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        facts = {key: value for key, value in self.server if key != "size"}
        return {"path": self.path, "bytes": self.bytes, "sha256": self.sha256, **facts}


def read_input_file(path: Location) -> InputFile:
    """A file with its checksum; one on a server is not fetched as a whole for it.

    Raises:
        RecordingError: it cannot be read.
    """
    if isinstance(path, RemotePath):
        return InputFile.unread(path)
    try:
        if path.is_dir():
            return InputFile(str(path), path.name, None, _listing_sha256(path))
        with path.open("rb") as file:
            digest = file_digest(file, "sha256").hexdigest()
            return InputFile(str(path), path.name, file.tell(), digest)
    except OSError as err:
        raise _unreadable(path, err) from err


class InputFiles:
    """The files of a recording, with checksums that a thread computes while the run makes frames.

    It reads what was read for the frames a moment ago and lies in the system's cache. So the first frame does not wait
    until all of the recording was read, and a disk delivers it once. To be closed.

    Args:
        paths: The files, in the order in which they are read.
        with_checksums: Whether they are read as a whole; if not, only their sizes are known.

    Attributes:
        unread: The files before they are read, with their sizes.
    """

    def __init__(self, paths: Sequence[Location], *, with_checksums: bool) -> None:
        self.unread = tuple(map(InputFile.unread, paths))
        self._paths, self._with_checksums = tuple(paths), with_checksums
        files = [path for path in paths if isinstance(path, Path) and path.is_file()] if with_checksums else []
        self._total = sum(InputFile.unread(path).bytes or 0 for path in files)
        self._due = 0
        self._digests: dict[Location, InputFile] = {}
        self._blocks = self._read(files)
        self._background = Background(math.inf, "lidcam-checksum")
        self._whole: tuple[InputFile, ...] | None = None

    def fingerprint(self) -> str:
        """Hexadecimal; differs between recordings, and is known at once: of names, sizes, beginnings and ends.

        Raises:
            RecordingError: a file cannot be read.
        """
        digest = sha256(repr([sorted(known.provenance.items()) for known in self.unread]).encode())
        for path in self._paths:
            if isinstance(path, Path) and path.is_file():
                digest.update(_ends(path))
        return digest.hexdigest()

    def read_up_to(self, share: float) -> None:
        """Have the thread read on, to `share` (0 to 1) of all bytes; does not wait for it.

        Raises:
            RecordingError: a file could not be read.
        """
        due = round(min(share, 1.0) * self._total)
        while due - self._due >= STEP_BYTES:
            self._add(STEP_BYTES)

    def finish(self) -> tuple[InputFile, ...]:
        """The files with their checksums, when all of them are read.

        Raises:
            RecordingError: a file cannot be read.
        """
        if not self._with_checksums:
            return self.unread
        if self._whole is None:
            while self._due < self._total:
                self._add(STEP_BYTES)
            self._background.add(lambda: self._advance(math.inf), 0)
            self._background.finish()
            # Folders and files on servers take no time.
            self._whole = tuple(self._digests.get(path) or read_input_file(path) for path in self._paths)
        return self._whole

    def close(self) -> None:
        """End the thread, whether or not it is done, and close the files."""
        self._background.close()
        self._blocks.close()

    def _add(self, size: int) -> None:
        """Have a step read; between two of them `close` ends the thread."""
        self._due += size
        self._background.add(lambda: self._advance(size), 0)

    def _advance(self, size: float) -> None:
        """On the thread."""
        while size > 0 and (found := next(self._blocks, 0)):
            size -= found

    def _read(self, paths: Sequence[Path]) -> Generator[int, None, None]:
        """Reads one file after the other; the sizes of the blocks, as they are read."""
        block = memoryview(bytearray(BLOCK_BYTES))
        for path in paths:
            digest, size = sha256(), 0
            try:
                with path.open("rb", buffering=0) as file:
                    while found := file.readinto(block):
                        digest.update(block[:found])
                        size += found
                        yield found
            except OSError as err:
                raise _unreadable(path, err) from err
            self._digests[path] = InputFile(str(path), path.name, size, digest.hexdigest())


def _unreadable(path: Path, err: OSError) -> RecordingError:
    return RecordingError(f"{path}: expected a file that can be read: {err.strerror or err}")


def _ends(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            beginning = file.read(END_BYTES)
            file.seek(max(path.stat().st_size - END_BYTES, 0))
            return beginning + file.read(END_BYTES)
    except OSError as err:
        raise _unreadable(path, err) from err


def _listing_sha256(folder: Path) -> str:
    digest = sha256()
    for file in sorted(file for file in folder.rglob("*") if file.is_file()):
        digest.update(f"{file.relative_to(folder).as_posix()} {file.stat().st_size}\n".encode())
    return digest.hexdigest()
