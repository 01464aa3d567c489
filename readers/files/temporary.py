"""Temporary folders for what must be unpacked or completed before it can be read."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from lidcam.pipeline.core.ending import undone_at_once


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder in the system's temporary folder; removed at the end of the block, or when a signal ends the run.

    Raises:
        OSError: it cannot be made.
    """
    with (
        TemporaryDirectory(prefix="lidcam-", ignore_cleanup_errors=True) as folder,
        undone_at_once(partial(shutil.rmtree, folder, ignore_errors=True)),
    ):
        yield Path(folder)
