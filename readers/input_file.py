"""What tells an input from others: its size and its checksum."""

from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.core.errors import RecordingError
from readers.location import Location, RemotePath

__all__ = ["InputFile", "read_input_file"]


class InputFile(NamedTuple):
    """An input file.

    Attributes:
        path: As it was given, without credentials; a ROS 2 folder and a split recording are the files that they hold.
        name: Name of the file.
        bytes: Its size; None where nothing says it: of a folder, and where a server does not.
        sha256: Of its content, hexadecimal; of an evaluation folder, of the names and sizes of its files. None where it
            was not read as a whole: of a file on a server, and where only a part was processed.
        server: What the server says of it: `size`, `etag`, `last_modified`.
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
        """What a result says of it: not where it lay."""
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
        raise RecordingError(f"{path}: expected a file that can be read: {err.strerror or err}") from err


def _listing_sha256(folder: Path) -> str:
    digest = sha256()
    for file in sorted(file for file in folder.rglob("*") if file.is_file()):
        digest.update(f"{file.relative_to(folder).as_posix()} {file.stat().st_size}\n".encode())
    return digest.hexdigest()
