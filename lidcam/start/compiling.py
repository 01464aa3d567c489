"""The first run on a machine: what it is made of is compiled while it is imported."""

from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["compiled_together"]


@contextmanager
def compiled_together() -> Iterator[None]:
    """Import what a run is made of in this block: all cores share what has to be compiled."""
    from pipeline.core.compiled import compiled_beside  # not at the top: `lidcam --help` needs no numpy
    from pipeline.parallel.cores import usable_cores

    with compiled_beside(usable_cores()):
        yield
