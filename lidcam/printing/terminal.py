"""A console that prints text as it is, and progress on a terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

__all__ = ["console", "progress_bar"]


def console(*, stderr: bool = False) -> Console:
    """A console that prints text as it is: names of topics and files may look like markup. Lines are not wrapped."""
    return Console(stderr=stderr, soft_wrap=True, markup=False, emoji=False)


@contextmanager
def progress_bar(err: Console, total_s: float) -> Iterator[Callable[[float], None]]:
    """Progress over recorded or simulated seconds, on a terminal only; call what comes back with the seconds done."""
    if not err.is_terminal:
        yield lambda _: None
        return
    columns = (TextColumn("{task.completed:.1f} of {task.total:.1f} s"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task("", total=total_s)
        yield lambda done_s: progress.update(task, completed=done_s)
