"""Progress of a command: a bar on a terminal, a line every ten seconds elsewhere and in a log file."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column

from lidcam.cli.printing.escaping import visible
from lidcam.cli.printing.log import progress_log
from lidcam.cli.printing.terminal import console

LINE_EVERY_S = 10.0
"""Wall time between lines."""

Clock = Callable[[], float]


@contextmanager
def show_progress(
    total_s: float, *, err: Console | None = None, clock: Clock = time.monotonic, whatever_is_logged: bool = False
) -> Iterator[Callable[[float, str], None]]:
    """Progress over `total_s` recorded or simulated seconds: yields a function of those that are done, and of facts.

    Other arguments as in `show_share`.
    """
    with show_share(err=err, clock=clock, whatever_is_logged=whatever_is_logged) as show:

        def advance(done_s: float, facts: str) -> None:
            show(f"{done_s:.1f} of {total_s:.1f} s", done_s / total_s if total_s else 1.0, facts)

        yield advance


@contextmanager
def show_training(
    *, err: Console | None = None, clock: Clock = time.monotonic
) -> Iterator[Callable[[float, str], None]]:
    """Progress of a training: yields a function of the share that is done and of facts; shows the time left.

    The first share is that of a resumed training.
    """
    with show_share(err=err, clock=clock) as show:
        start: tuple[float, float] | None = None

        def told(share: float, facts: str) -> None:
            nonlocal start
            start = start or (clock(), share)
            text = f"training: {share:.0%}"
            if share > start[1]:
                left_s = (clock() - start[0]) * (1 - share) / (share - start[1])
                text += f", about {left_s / 60:.0f} min left"
            show(text, share, facts)

        yield told


@contextmanager
def show_share(
    *, err: Console | None = None, clock: Clock = time.monotonic, whatever_is_logged: bool = False
) -> Iterator[Callable[[str, float, str], None]]:
    """Progress of any work: yields a function of a text, the share that is done, and facts.

    The bar is drawn at the first call, on stderr if no console is given; a notebook counts as a terminal.
    `whatever_is_logged` draws it even if progress is not logged.
    """
    err = err or console(stderr=True)
    has_bar = (err.is_terminal or err.is_jupyter) and (whatever_is_logged or progress_log.isEnabledFor(logging.INFO))
    last_s, last_line = clock(), ""
    columns = (
        TextColumn("{task.fields[text]}", markup=False),
        BarColumn(bar_width=8),
        TextColumn("{task.description}", markup=False, table_column=Column()),  # is folded where it is too long
        TimeRemainingColumn(),
    )
    with ExitStack() as stack:
        bar = Progress(*columns, console=err, transient=True)

        def show(text: str, share: float, facts: str) -> None:
            nonlocal last_s, last_line
            if has_bar:
                if not bar.tasks:
                    stack.enter_context(bar)
                    bar.add_task("", text="", total=1.0)
                bar.update(bar.tasks[0].id, completed=share, description=visible(facts), text=text)
            line = f"{text}, {facts}" if facts else text
            if clock() - last_s >= LINE_EVERY_S and line != last_line:
                last_s, last_line = clock(), line
                progress_log.info("%s", line)

        yield show
