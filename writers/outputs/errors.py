"""Errors of the system about an output, as one line."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from lidcam.pipeline.core.errors import OutputError


@contextlib.contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turn an OSError raised in the block into an OutputError about `path`."""
    try:
        yield
    except OSError as err:
        raise OutputError(f"{path}: cannot be written: {err.strerror or err}") from err
