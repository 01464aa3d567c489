"""The folder of a batch, local or in an object store: its results, the records of its jobs, and the table of them."""

import logging
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import pyarrow as pa
import pyarrow.parquet as pq

from lidcam.batches.jobs import RECORDS, TABLE_STEM
from lidcam.batches.records import JobRecord, record_of, record_text
from lidcam.outputs.bucket import Bucket, check_output
from lidcam.outputs.written import WrittenFile, written_file
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.small_files import read_small_file
from lidcam.pipeline.core.system import NO_FOLLOW, NO_WAIT, NOT_INHERITED, lock_file
from lidcam.readers.location import Location
from lidcam.writers.outputs.transaction import OutputTransaction

TABLE = f"{TABLE_STEM}.parquet"
"""Table of the batch, in the folder of the results; readers of a folder of tables skip names like this."""

SCHEMA = pa.schema(
    [
        ("recording", pa.string()),
        ("input", pa.string()),
        ("state", pa.string()),
        ("exit_code", pa.int32()),
        ("message", pa.string()),
        ("frames", pa.int64()),
        ("objects", pa.list_(pa.struct([("class", pa.string()), ("count", pa.int64())]))),
        ("road_users", pa.list_(pa.struct([("class", pa.string()), ("count", pa.int64())]))),
        ("dropped", pa.int64()),
        ("skew_max_ms", pa.float64()),
        ("lacking", pa.list_(pa.struct([("sensor", pa.string()), ("frames", pa.int64())]))),
        ("processor_s", pa.float64()),
        ("wall_s", pa.float64()),
        ("peak_mib", pa.float64()),
        ("sha256", pa.list_(pa.string())),
        ("settings", pa.string()),
        ("settings_sha256", pa.string()),
        ("version", pa.string()),
    ]
)


def records_table(records: Sequence[JobRecord]) -> bytes:
    """A row for each record, as Parquet."""
    rows = [
        {
            **asdict(one),
            "recording": one.name,
            "objects": [{"class": name, "count": count} for name, count in (one.objects or {}).items()],
            "road_users": [{"class": name, "count": count} for name, count in (one.road_users or {}).items()],
            "lacking": [{"sensor": name, "frames": count} for name, count in (one.lacking or {}).items()],
        }
        for one in records
    ]
    content = BytesIO()
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), content)
    return content.getvalue()


MAX_RECORD_BYTES = 16 << 20

logger = logging.getLogger(__name__)


class LocalFiles:
    """Files below a local folder, by their names relative to it: a `Bucket` without fsspec, which is an extra.

    The folder is made if it is missing, and may be a link, as its user named it. Below it nothing is followed or opened
    but folders and plain files: methods raise OutputError where something else stands.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def at(self, name: str) -> Path:
        """The location of a file, in a folder that is made if it is missing."""
        *folders, last = name.split("/")
        path = self._folder
        for folder in folders:
            path /= folder
            with suppress(FileExistsError):
                path.mkdir()
            if not stat.S_ISDIR(path.lstat().st_mode):
                raise OutputError(f"{path}: expected a folder, found a link or a file: choose another folder")
        path /= last
        if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
            raise OutputError(f"{path}: expected a file, found a link, a folder, a device or a pipe; remove it")
        return path

    def written(self, name: str, known: WrittenFile | None = None) -> WrittenFile | None:
        """A file with its checksum; None where there is none. It is not read again if it is unchanged since `known`."""
        return written_file(self.at(name), known)

    def read(self, name: str) -> bytes | None:
        """The content of a file; None where there is none."""
        path = self.at(name)
        return read_small_file(path, MAX_RECORD_BYTES) if path.exists() else None

    def put(self, name: str, content: bytes) -> None:
        """Write a file, whole or not at all."""
        with OutputTransaction([path := self.at(name)]) as outputs:
            outputs[path].write_bytes(content)


class Store:
    """The folder of a batch, with its `files`. Methods raise OSError or OutputError where it cannot be used.

    A local one is made if it is missing. Raises LidcamError if it cannot be used, or a library is not installed.
    """

    def __init__(self, out: Location) -> None:
        self.files: LocalFiles | Bucket
        if isinstance(out, Path):
            try:
                self.files = LocalFiles(out)
                with self.held("", is_awaited=True), OutputTransaction([out / TABLE]):
                    pass  # it could be written
            except OSError as err:
                raise OutputError(f"{out}: expected a folder that can be written to: {err}") from err
        else:
            check_output(out)
            self.files = bucket = Bucket(out)
            bucket.check()

    def record(self, job: str) -> JobRecord | None:
        """The record of a job; None where there is none that can be read, of which a warning tells."""
        try:
            content = self.files.read(f"{RECORDS}/{job}.json")
        except OSError:  # too large
            content = b""
        record = None if content is None else record_of(content)
        if record is not None and record.name == job:
            return record
        if content is not None:
            logger.warning("%s: its record in %s is damaged or of another version: it is processed again", job, RECORDS)
        return None

    def keep(self, record: JobRecord) -> None:
        """Write the record of a job."""
        self.files.put(f"{RECORDS}/{record.name}.json", record_text(record))

    def keep_of_all(self, name: str, content: bytes) -> None:
        """Write a file about all jobs; another batch that writes one is waited for."""
        with self.held("", is_awaited=True):
            self.files.put(name, content)

    @contextmanager
    def held(self, job: str, *, is_awaited: bool = False) -> Iterator[int | None]:
        """A descriptor that keeps other batches from a job while it is open anywhere; None where another has it.

        A bucket has no locks: what two batches do there at once is done twice, with the same result.
        Without the name of a job, it is the table of the batch.
        """
        lock = self.files.at(f"{RECORDS}/{job}.lock")
        with _open_lock(lock) if isinstance(lock, Path) else TemporaryFile() as file:
            try:
                lock_file(file, is_awaited=is_awaited)
            except BlockingIOError:
                yield None
            else:
                yield file.fileno()


def _open_lock(path: Path) -> IO[bytes]:
    """A lock, made if it is missing."""
    flags = NO_FOLLOW | NO_WAIT | NOT_INHERITED
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | flags, 0o666)
    except PermissionError:  # of another user who shares the folder
        descriptor = os.open(path, os.O_RDONLY | flags)
    return os.fdopen(descriptor, "rb")
