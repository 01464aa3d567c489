"""Where a batch keeps its results, and what it knows of each job: a folder, or one of an object store."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Protocol

from lidcam.batch.records import FOLDER, JobRecord, read_record, record_of, record_text, write_record
from lidcam.outputs.bucket import Bucket, check_output
from lidcam.pipeline.core.errors import OutputError
from lidcam.readers.location import Location, RemotePath


class Store(Protocol):
    """Names are relative to the folder of the batch. Methods raise OSError or LidcamError where they cannot be done."""

    def place(self, name: str) -> str:
        """The file of this name, for a command line; its folder is there."""

    def size(self, name: str) -> int | None:
        """Size of a file in bytes; None where there is none."""

    def write(self, name: str, content: bytes) -> None:
        """Write a file, whole or not at all."""

    def record(self, job: str) -> JobRecord | None:
        """What is known of a job; None where there is nothing that can be read."""

    def keep(self, record: JobRecord) -> None:
        """Keep it."""

    @contextmanager
    def held(self, job: str) -> Iterator[int | None]:
        """A descriptor that keeps other batches from a job while it is open anywhere; None where another has it."""
        ...


class FolderStore:
    """A local folder.

    Args:
        folder: It is made if it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def place(self, name: str) -> str:
        """See `Store`."""
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return str(path)

    def size(self, name: str) -> int | None:
        """See `Store`."""
        path = self._folder / name
        return path.stat().st_size if path.is_file() else None

    def write(self, name: str, content: bytes) -> None:
        """See `Store`."""
        path = self._folder / name
        beside = path.with_name(f"{path.name}.new")
        beside.write_bytes(content)
        beside.replace(path)

    def record(self, job: str) -> JobRecord | None:
        """See `Store`."""
        return read_record(self._record(job))

    def keep(self, record: JobRecord) -> None:
        """See `Store`."""
        write_record(self._record(record.name), record)

    @contextmanager
    def held(self, job: str) -> Iterator[int | None]:
        """See `Store`: a process that inherits the descriptor keeps the lock."""
        path = self._record(job)
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.with_suffix(".lock").open("ab") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                yield None
            else:
                yield file.fileno()

    def _record(self, job: str) -> Path:
        return self._folder / FOLDER / f"{job}.json"


class BucketStore:
    """A folder of an object store. It has no locks: what two batches do there at once is done twice, with one result.

    Args:
        root: Its URL.

    Raises:
        LidcamError: there is no such bucket, it cannot be listed, or what is needed for it is not installed.
    """

    def __init__(self, root: RemotePath) -> None:
        check_output(root)
        self._bucket = Bucket(root)
        self._bucket.check()

    def place(self, name: str) -> str:
        """See `Store`."""
        return self._bucket.at(name).url

    def size(self, name: str) -> int | None:
        """See `Store`."""
        return self._bucket.size(name)

    def write(self, name: str, content: bytes) -> None:
        """See `Store`."""
        self._bucket.put(name, content)

    def record(self, job: str) -> JobRecord | None:
        """See `Store`."""
        content = self._bucket.read(f"{FOLDER}/{job}.json")
        return None if content is None else record_of(content)

    def keep(self, record: JobRecord) -> None:
        """See `Store`."""
        self._bucket.put(f"{FOLDER}/{record.name}.json", record_text(record))

    @contextmanager
    def held(self, job: str) -> Iterator[int | None]:  # noqa: ARG002  # no job is kept from others
        """See `Store`."""
        with TemporaryFile() as file:
            yield file.fileno()


def open_store(out: Location) -> Store:
    """The store at a place.

    Raises:
        LidcamError: it cannot be used.
    """
    if not isinstance(out, Path):
        return BucketStore(out)
    try:
        return FolderStore(out)
    except OSError as err:
        raise OutputError(f"{out}: expected a folder that can be written to: {err}") from err
