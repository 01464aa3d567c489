"""Files that PyTorch has written, which may come from anywhere: bounds before they are loaded."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from stat import S_ISREG
from typing import BinaryIO
from zipfile import ZipFile, is_zipfile


@contextmanager
def torch_file(path: Path) -> Iterator[BinaryIO]:
    """An open file for `torch.load`. Neither waits for a FIFO, nor lets an archive grow when it is unpacked.

    Raises:
        OSError: it cannot be opened, or is no regular file.
        ValueError: it would grow; PyTorch does not compress.
    """
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        status = os.fstat(file.fileno())
        if not S_ISREG(status.st_mode):
            raise OSError("no regular file")
        if is_zipfile(file):
            with ZipFile(file) as archive:
                unpacked = sum(one.file_size for one in archive.infolist())
            if unpacked > status.st_size:
                raise ValueError(f"{status.st_size / 2**20:.1f} MiB that would be {unpacked / 2**20:.0f} when unpacked")
        file.seek(0)
        yield file
