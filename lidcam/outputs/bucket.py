"""A folder of an object store: what is found in it, and what is put there, each object whole or not at all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from lidcam.outputs.allowed import OVERWRITING
from lidcam.outputs.written import WrittenFile
from lidcam.pipeline.core.errors import LidcamError, OutputError, RecordingError, is_short_memory
from lidcam.readers.files.remote import REMEDY, file_system, meaning_of
from lidcam.readers.location import RemotePath
from lidcam.readers.natural_order import natural_key

T = TypeVar("T")

PART_BYTES = 16 << 20
"""Size of the parts in which a large file is sent."""

PARTS_AT_ONCE = 4
"""Number of parts in memory."""

MARK = {"lidcam": "result"}
"""Metadata of each object that lidcam puts; others are not replaced unasked."""


def is_bucket(place: object) -> bool:
    """Whether a location is one that can be listed and written to."""
    return isinstance(place, RemotePath) and place.protocol in {"s3", "s3a"}


def check_output(place: RemotePath) -> None:
    """Check that results can be written to a URL."""
    if not is_bucket(place) or "?" in place.url or "#" in place.url:
        raise OutputError(f"{place}: expected a local path, or s3://bucket/..., as output")


class Bucket:
    """Objects below one URL, `s3://bucket/prefix`. All methods may be called from several threads.

    They raise OutputError, and those that read recordings RecordingError, where the server does not do what is asked.
    """

    def __init__(self, root: RemotePath) -> None:
        self.root = RemotePath(root.url.rstrip("/"))
        self._system = file_system(root)

    def at(self, name: str) -> RemotePath:
        """The object of this name."""
        return RemotePath(f"{self.root.url}/{name}")

    def check(self) -> None:
        """Check that there is such a bucket, and that it may be listed."""
        with _told(self.root, OutputError):
            self._system.call_s3("head_bucket", Bucket=self._system.split_path(self.root.url)[0])

    def found(self) -> list[tuple[RemotePath, int]]:
        """All objects below the URL, or the one that it names, with their sizes in bytes; in natural order."""
        with _told(self.root, RecordingError):
            entries: dict[str, Any] = self._system.find(self.root.url, detail=True)
        found = [(RemotePath(f"{self.root.protocol}://{name}"), int(one["size"])) for name, one in entries.items()]
        return sorted(found, key=lambda one: natural_key(one[0].url))

    def read(self, name: str) -> bytes | None:
        """The content of an object; None where there is none."""
        return self._unless_missing(name, lambda url: bytes(self._system.cat_file(url)))

    def written(self, name: str, known: WrittenFile | None = None) -> WrittenFile | None:  # noqa: ARG002  # not read
        """Size and ETag of an object; None where there is none."""
        found: dict[str, Any] | None = self._unless_missing(name, self._system.info)
        return None if found is None else WrittenFile(int(found["size"]), str(found["ETag"]))

    def check_replaceable(self, name: str) -> None:
        """Check that an object may be written: there is none, or lidcam put it there."""
        if self._unless_missing(name, lambda url: MARK.items() <= self._system.metadata(url).items()) is False:
            raise OutputError(f"{self.at(name)}: exists and was not written by lidcam; {OVERWRITING}")

    def put(self, name: str, content: bytes) -> None:
        """Put an object, whole or not at all."""
        with _told(self.at(name), OutputError):
            self._system.pipe_file(self.at(name).url, content, Metadata=MARK)

    def put_file(self, name: str, path: Path) -> None:
        """Put the content of a file, a large one in parts, whole or not at all."""
        with _told(self.at(name), OutputError):
            self._system.put_file(
                str(path), self.at(name).url, chunksize=PART_BYTES, max_concurrency=PARTS_AT_ONCE, Metadata=MARK
            )

    def _unless_missing(self, name: str, ask: Callable[[str], T]) -> T | None:
        with _told(self.at(name), OutputError):
            try:
                return ask(self.at(name).url)
            except FileNotFoundError as err:
                if "bucket" in str(err):
                    raise
                return None


@contextmanager
def _told(place: RemotePath, kind: type[LidcamError]) -> Iterator[None]:
    """Turn errors of the libraries below into one line without secrets; they have tried again what may pass."""
    try:
        yield
    except Exception as err:  # any library below may raise
        if is_short_memory(err):
            raise
        reason, may_pass = meaning_of(err)
        if isinstance(err, FileNotFoundError):
            reason = "there is no such bucket; check the address"
        elif may_pass:
            reason = f"{reason} after several attempts; check the network, and try again"
        raise kind(f"{place}: {reason.replace(f', or {REMEDY}', '')}") from None
