"""Files that a run has written, as they are recognised later."""

import os
from dataclasses import dataclass, field
from hashlib import file_digest
from pathlib import Path

from lidcam.pipeline.core.small_files import open_regular
from lidcam.pipeline.core.system import NO_FOLLOW


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """Size and checksum of a file; two are equal if these are."""

    bytes: int  # Size in bytes
    checksum: str  # SHA-256 of a local file, hexadecimal; ETag of an object in a bucket
    # Inode, time of the last write and of the last change of a local file: a file that still has them was not changed
    facts: str = field(default="", compare=False)


def written_file(path: Path, known: WrittenFile | None = None) -> WrittenFile | None:
    """The file at a path, which is not followed if it is a link; None where nothing is.

    It is read only if it has changed since it was written as `known`; raises OSError if it is no regular file.
    """
    if not os.path.lexists(path):
        return None
    with open_regular(path, NO_FOLLOW) as file:
        status = os.fstat(file.fileno())
        facts = f"{status.st_ino} {status.st_mtime_ns} {status.st_ctime_ns}"
        if known is not None and (known.bytes, known.facts) == (status.st_size, facts):
            return known
        return WrittenFile(status.st_size, file_digest(file, "sha256").hexdigest(), facts)
