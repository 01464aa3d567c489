"""Progress of a command: a bar on a terminal, a line every ten seconds elsewhere."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console

from lidcam.printing.escaping import visible
from lidcam.printing.log import progress_log
from lidcam.printing.terminal import console

__all__ = ["Advance", "show_progress"]

LINE_EVERY_S = 10.0
"""Wall time from one line to the next."""


class Advance(Protocol):
    """To be called now and then."""

    def __call__(self, done_s: float, facts: str = "") -> None:
        """Report that `done_s` recorded or simulated seconds are done, with `facts` to show beside the bar."""


@contextmanager
def show_progress(
    total_s: float, *, err: Console | None = None, clock: Callable[[], float] = time.monotonic
) -> Iterator[Advance]:
    """Progress over recorded or simulated seconds.

    On a terminal there is a bar, unless --quiet is given. Elsewhere, and in a log file, there is a line every ten
    seconds.

    Args:
        total_s: Seconds that will be done in the end.
        err: Where the bar is drawn; None: stderr.
        clock: Seconds of wall time.
    """
    err = err or console(stderr=True)
    line = _Lines(total_s, clock)
    if not err.is_terminal or not progress_log.isEnabledFor(logging.INFO):
        yield line
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn  # for terminals alone

    columns = (
        TextColumn("{task.completed:.1f} of {task.total:.1f} s", markup=False),
        BarColumn(bar_width=None),
        TextColumn("{task.description}", markup=False),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task("", total=total_s)

        def advance(done_s: float, facts: str = "") -> None:
            progress.update(task, completed=done_s, description=visible(facts))
            line(done_s, facts)

        yield advance


class _Lines:
    """Logs a line of progress when the last one is long ago."""

    def __init__(self, total_s: float, clock: Callable[[], float]) -> None:
        self._total_s, self._clock = total_s, clock
        self._last_s = clock()

    def __call__(self, done_s: float, facts: str = "") -> None:
        now_s = self._clock()
        if now_s - self._last_s >= LINE_EVERY_S:
            self._last_s = now_s
            progress_log.info("%.1f of %.1f s%s", done_s, self._total_s, f", {facts}" if facts else "")
