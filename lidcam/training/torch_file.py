"""Files that PyTorch has written, which may come from anywhere: bounds before they are loaded."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO
from zipfile import ZipFile, is_zipfile

from lidcam.pipeline.core.small_files import open_regular


@contextmanager
def torch_file(path: Path) -> Iterator[BinaryIO]:
    """An open file for `torch.load`. Neither waits for a FIFO, nor lets an archive grow when it is unpacked.

    Raises OSError if it cannot be opened, or is no regular file, and ValueError if it would grow: PyTorch does not
    compress.
    """
    with open_regular(path) as file:
        if is_zipfile(file):
            size = os.fstat(file.fileno()).st_size
            with ZipFile(file) as archive:
                unpacked = sum(one.file_size for one in archive.infolist())
            if unpacked > size:
                raise ValueError(f"{size / 2**20:.1f} MiB that would be {unpacked / 2**20:.0f} when unpacked")
        file.seek(0)
        yield file
