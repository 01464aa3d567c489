"""Base of the readers of all file formats: how to read the file, and the record of its damage."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import BinaryIO

from lidcam.pipeline.core.errors import RecordingError
from lidcam.readers.files.damage import Losses
from lidcam.readers.files.rosbag2_folder import FolderMetadata
from lidcam.readers.location import Location
from lidcam.readers.recording import Loss, ReadOptions

LARGE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Source:
    """One file of a recording, whatever its format."""

    path: Location  # The file as messages name it
    index: int  # Its place in the recording
    options: ReadOptions  # How it is read
    losses: Losses  # Collects its damage
    metadata: FolderMetadata = field(default_factory=FolderMetadata)  # Content of the metadata.yaml in its folder


class Container(ABC):
    """One open file; see `RecordingFile`, whose other attributes a subclass sets in `_describe`. Closes its stream."""

    def __init__(self, source: Source, stream: BinaryIO) -> None:
        self.path = source.path
        self._source = source
        self._limits = source.options.limits
        self._losses = source.losses
        self._stream = stream
        self._describe()

    @abstractmethod
    def _describe(self) -> None:
        """Find out what the file contains."""

    @property
    def losses(self) -> tuple[Loss, ...]:
        """See `RecordingFile`."""
        return self._losses.listed()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _check_open(self) -> None:
        if self._stream.closed:
            raise RecordingError(f"{self.path}: expected an open recording, but it was closed")


def read_exactly(stream: BinaryIO, size: int) -> bytes:
    """The next `size` bytes; raises EOFError if the file ends before."""
    if size > LARGE_BYTES:  # the stream would allocate it before it looks
        at = stream.tell()
        left = stream.seek(0, 2) - at
        stream.seek(at)
        if size > left:
            raise EOFError(f"expected {size} more bytes, found {left}")
    data = stream.read(size)
    if len(data) != size:
        raise EOFError(f"expected {size} more bytes, found {len(data)}")
    return data
