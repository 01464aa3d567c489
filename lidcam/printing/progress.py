"""Progress of a command: a bar on a terminal, a line every ten seconds elsewhere."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from lidcam.printing.escaping import visible
from lidcam.printing.log import progress_log
from lidcam.printing.terminal import console

__all__ = ["Advance", "show_compiling", "show_progress"]

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


@contextmanager
def show_compiling(
    *, err: Console | None = None, clock: Callable[[], float] = time.monotonic
) -> Iterator[Callable[[int, int], None]]:
    """Progress of the first run on a machine: yields what is told how many functions of how many are compiled.

    On a terminal there is a bar as soon as something is compiled, unless --quiet is given; elsewhere a line every ten
    seconds.

    Args:
        err: Where the bar is drawn; None: stderr.
        clock: Seconds of wall time.
    """
    err = err or console(stderr=True)
    last_s = clock()
    with ExitStack() as stack:
        bars: list[tuple[Progress, TaskID]] = []

        def compiled(done: int, total: int) -> None:
            nonlocal last_s
            if err.is_terminal and progress_log.isEnabledFor(logging.INFO):
                if not bars:
                    columns = TextColumn("compiling: {task.completed} of {task.total}"), BarColumn(bar_width=None)
                    bar = stack.enter_context(Progress(*columns, console=err, transient=True))
                    bars.append((bar, bar.add_task("", total=total)))
                bar, task = bars[0]
                bar.update(task, completed=done)
            if clock() - last_s >= LINE_EVERY_S:
                last_s = clock()
                progress_log.info("compiling: %d of %d", done, total)

        yield compiled


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
