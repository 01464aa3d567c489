"""Inputs identified by size and checksum; one that cannot be read raises a `RecordingError`."""

import math
import os
from collections import defaultdict
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, suppress
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.system import read_at
from lidcam.readers.location import Location, RemotePath

END_BYTES = 1 << 16
"""Bytes read at the beginning and at the end of a file for a fingerprint: the first clouds or images, and the index."""

BLOCK_BYTES = 1 << 20
"""Bytes read at once for a checksum."""

STEP_BYTES = 1 << 22
"""Minimum number of bytes that is worth waking a thread."""


class InputFile(NamedTuple):
    """An input file."""

    path: str  # As it was given, without credentials; a ROS 2 folder and a split recording are the files that they hold
    name: str  # Name of the file
    bytes: int | None = None  # Its size; None of a folder, and where a server does not say it
    # Digest of its content, hexadecimal. None where it was not read as a whole: of a file on a server, and where only a
    # part was processed; and where it was changed while it was read
    sha256: str | None = None
    server: tuple[tuple[str, str], ...] = ()  # Facts that the server gives: `size`, `etag`, `last_modified`
    is_changed: bool = False  # Whether it was changed while it was read

    @classmethod
    def unread(cls, path: Location) -> "InputFile":
        """A file by its path and size; of one on a server, the size that was given when it was opened."""
        if isinstance(path, RemotePath):
            size = dict(path.facts).get("size", "")
            return cls(str(path), path.name, int(size) if size.isdecimal() else None, None, path.facts)
        return cls(str(path), path.name, path.stat().st_size if path.is_file() else None)

    @property
    def provenance(self) -> dict[str, str]:
        """Record of the file in a result, without its folder."""
        if self.sha256 is not None:
            return {"name": self.name, "sha256": self.sha256}
        if "://" in self.path:
            return {"name": self.name, "url": self.path, **dict(self.server)}
        return {"name": self.name} | ({} if self.bytes is None else {"size": str(self.bytes)})

    @property
    def as_read(self) -> dict[str, str]:
        """The rest of that record, known at the end of a run."""
        if self.is_changed:
            return {"changed": "while it was read"}
        return {} if self.sha256 is None else {"sha256": self.sha256}

    def tree(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        facts = {key: value for key, value in self.server if key != "size"}
        return {"path": self.path, "bytes": self.bytes, "sha256": self.sha256, **facts}


def recorded_inputs(metadata: Mapping[str, str]) -> list[dict[str, str]]:
    """The records of the input files in the metadata of a result (`provenance` and `as_read`), in their order."""
    records = defaultdict[int, dict[str, str]](dict)
    for key, value in metadata.items():
        section, _, rest = key.partition(".")
        row, _, fact = rest.partition(".")
        if section == "input" and row.isdecimal():
            records[int(row)][fact] = value
    return [records[row] for row in sorted(records)]


def read_input_file(path: Location) -> InputFile:
    """A file with its checksum; one on a server is not fetched as a whole for it."""
    if isinstance(path, RemotePath):
        return InputFile.unread(path)
    try:
        with path.open("rb") as file:
            digest = file_digest(file, "sha256").hexdigest()
            return InputFile(str(path), path.name, file.tell(), digest)
    except OSError as err:
        raise _unreadable(path, err) from err


class OpenedFile:
    """A file of a recording as it was opened; one that takes its name later is another file.

    Attributes:
        path: Where it was.
        stream: Its bytes, open as long as the recording; None of a file on a server.
        unread: Its name and its size, as it was opened.
    """

    def __init__(self, path: Location, stream: BinaryIO | None = None) -> None:
        self.path, self.stream = path, stream
        self._state = None if stream is None else _state(stream)
        self.unread = InputFile(str(path), path.name, self._state[0]) if self._state else InputFile.unread(path)

    @property
    def is_changed(self) -> bool:
        """Whether it was written to since it was opened."""
        return self.stream is not None and _state(self.stream) != self._state

    def read(self, at: int, size: int) -> bytes:
        """At most `size` bytes from `at` on; leaves the stream's position alone."""
        try:
            return b"" if self.stream is None else read_at(self.stream, size, at)
        except OSError as err:
            raise _unreadable(self.path, err) from err


class InputFiles:
    """The files of a recording, with checksums that a thread computes of what was just read for frames; to be closed.

    Attributes:
        unread: The files before they are read, with their sizes.
        named: Other files that the run reads, by key; after `finish` it is known whether they were changed.
    """

    def __init__(self, files: Sequence[OpenedFile], named: Mapping[str, InputFile], *, with_checksums: bool) -> None:
        self.unread, self.named = tuple(file.unread for file in files), named
        self._files, self._with_checksums = tuple(files), with_checksums
        local = [file for file in files if file.stream] if with_checksums else []
        self._total = sum(file.unread.bytes or 0 for file in local)
        self._due = 0
        self._digests: dict[OpenedFile, str] = {}
        self._blocks = self._read(local)
        self._thread, self._steps = ThreadPoolExecutor(1, "lidcam-checksum"), list[Future[None]]()
        self._whole: tuple[InputFile, ...] | None = None

    def fingerprint(self) -> str:
        """Hexadecimal digest that is known at once: of names, sizes, beginnings and ends, and of the other files."""
        digest = sha256(repr([sorted(known.provenance.items()) for known in self.unread]).encode())
        for file in self._files:
            digest.update(file.read(0, END_BYTES))
            digest.update(file.read(max((file.unread.bytes or 0) - END_BYTES, 0), END_BYTES))
        digest.update("".join(file.sha256 or "" for file in self.named.values()).encode())
        return digest.hexdigest()

    def read_up_to(self, share: float) -> None:
        """Have the thread read on, to `share` (0 to 1) of all bytes; does not wait for it."""
        due = round(min(share, 1.0) * self._total)
        while due - self._due >= STEP_BYTES:
            self._add_step(STEP_BYTES)

    def finish(self) -> tuple[InputFile, ...]:
        """The files as they were read, with their checksums; a file that was changed meanwhile has none."""
        if self._whole is None:
            while self._due < self._total:
                self._add_step(STEP_BYTES)
            if self._with_checksums:
                self._add_step(math.inf)
            for step in self._steps:
                step.result()
            self._whole = tuple(map(self._finished, self._files))
            self.named = {key: _compared(file) for key, file in self.named.items()}
        return self._whole

    def _finished(self, file: OpenedFile) -> InputFile:
        if file.is_changed:
            return file.unread._replace(is_changed=True)
        return file.unread._replace(sha256=self._digests.get(file))

    def close(self) -> None:
        """End the thread, whether or not it is done, and close the files."""
        self._thread.shutdown(cancel_futures=True)
        self._blocks.close()

    def _add_step(self, size: float) -> None:
        """Have a step read; between two of them `close` ends the thread."""
        self._due += STEP_BYTES
        self._steps.append(self._thread.submit(self._advance, size))

    def _advance(self, size: float) -> None:
        """On the thread."""
        while size > 0 and (found := next(self._blocks, 0)):
            size -= found

    def _read(self, files: Sequence[OpenedFile]) -> Generator[int, None, None]:
        """Reads one file after the other, each as far as it went when it was opened; the sizes of the blocks."""
        for file in files:
            digest, at, size = sha256(), 0, file.unread.bytes or 0
            while block := file.read(at, min(BLOCK_BYTES, size - at)):
                digest.update(block)
                at += len(block)
                yield len(block)
            self._digests[file] = digest.hexdigest()


def read_opened_files(files: Sequence[OpenedFile]) -> tuple[InputFile, ...]:
    """The files of a recording as they were read, with their checksums."""
    with closing(InputFiles(files, {}, with_checksums=True)) as known:
        return known.finish()


def _state(stream: BinaryIO) -> tuple[int, int]:
    """Size, and time of the last change."""
    status = os.fstat(stream.fileno())
    return status.st_size, status.st_mtime_ns


def _compared(before: InputFile) -> InputFile:
    """A file that is read by its name, any number of times: changed unless it has the same content still."""
    with suppress(RecordingError):
        if read_input_file(Path(before.path)) == before:
            return before
    return before._replace(sha256=None, is_changed=True)


def _unreadable(path: Location, err: OSError) -> RecordingError:
    return RecordingError(f"{path}: expected a file that can be read: {err.strerror or err}")
