"""The folder of a batch, local or in an object store: its results, and the records of its jobs."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Protocol

from lidcam.batch.records import FOLDER, JobRecord, record_of, record_text
from lidcam.outputs.bucket import Bucket, check_output
from lidcam.pipeline.core.errors import OutputError
from lidcam.readers.location import Location


class Files(Protocol):
    """Files below a folder, by their names relative to it: a `Bucket`, or a local folder."""

    def at(self, name: str) -> Location:
        """The location of a file."""

    def size(self, name: str) -> int | None:
        """The size of a file in bytes; None where there is none."""

    def read(self, name: str) -> bytes | None:
        """The content of a file; None where there is none."""

    def put(self, name: str, content: bytes) -> None:
        """Write a file, whole or not at all."""


class LocalFiles:
    """Files below a local folder, which is made if it is missing: `Files` without fsspec, which is an extra."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def at(self, name: str) -> Path:
        """See `Files`; the folder of the file is made."""
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def size(self, name: str) -> int | None:
        """See `Files`."""
        path = self._folder / name
        return path.stat().st_size if path.is_file() else None

    def read(self, name: str) -> bytes | None:
        """See `Files`."""
        path = self._folder / name
        return path.read_bytes() if path.is_file() else None

    def put(self, name: str, content: bytes) -> None:
        """See `Files`."""
        path = self.at(name)
        beside = path.with_name(f"{path.name}.new")
        beside.write_bytes(content)
        beside.replace(path)


class Store:
    """The folder of a batch. Methods raise OSError or OutputError where it cannot be used.

    Args:
        out: The folder; a local one is made if it is missing.

    Attributes:
        files: The files in it.

    Raises:
        LidcamError: it cannot be used, or a library for it is not installed.
    """

    def __init__(self, out: Location) -> None:
        self.files: Files
        if isinstance(out, Path):
            try:
                self.files = LocalFiles(out)
            except OSError as err:
                raise OutputError(f"{out}: expected a folder that can be written to: {err}") from err
        else:
            check_output(out)
            self.files = bucket = Bucket(out)
            bucket.check()

    def record(self, job: str) -> JobRecord | None:
        """The record of a job; None where there is none that can be read."""
        content = self.files.read(f"{FOLDER}/{job}.json")
        return None if content is None else record_of(content)

    def keep(self, record: JobRecord) -> None:
        """Write the record of a job."""
        self.files.put(f"{FOLDER}/{record.name}.json", record_text(record))

    @contextmanager
    def held(self, job: str) -> Iterator[int | None]:
        """A descriptor that keeps other batches from a job while it is open anywhere; None where another has it.

        A bucket has no locks: what two batches do there at once is done twice, with the same result.
        """
        lock = self.files.at(f"{FOLDER}/{job}.lock")
        with lock.open("ab") if isinstance(lock, Path) else TemporaryFile() as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                yield None
            else:
                yield file.fileno()
