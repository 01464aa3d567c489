"""The first run on a machine: what it is made of is compiled while it is imported."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial


@contextmanager
def compiled_together(*, shown: bool = False) -> Iterator[None]:
    """Import what a run is made of in this block: all cores share what has to be compiled.

    Args:
        shown: Draw a bar on a terminal, or log lines of progress.
    """
    from lidcam.cli.printing.progress import show_share  # not at the top: `lidcam --help` needs no numpy
    from lidcam.pipeline.core.compiled import compiled_beside
    from lidcam.pipeline.parallel.cores import usable_cores

    if not shown:
        with compiled_beside(usable_cores()):
            yield
        return
    with show_share() as show, compiled_beside(usable_cores(), partial(_show_compiled, show)):
        yield


def _show_compiled(show: Callable[[str, float, str], None], done: int, total: int) -> None:
    show(f"compiling: {done} of {total}", done / total, "")
