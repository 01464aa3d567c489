"""Printing of `lidcam batch`: a progress bar and the table of recordings."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console

from lidcam.batches.jobs import BatchJob
from lidcam.batches.records import JobRecord, totals_line
from lidcam.cli.printing.progress import show_share
from lidcam.cli.printing.tables import ColumnsTable
from lidcam.cli.printing.terminal import show_line, show_table

MAX_ROWS = 30
"""Maximum number of recordings that all have a row."""


@contextmanager
def shown_batch(jobs: Sequence[BatchJob]) -> Iterator[Callable[[JobRecord], None]]:
    """Progress over the bytes of all recordings: yields a function to call with each record that is complete."""
    sizes = {job.name: job.bytes or 1 for job in jobs}
    total, done, ended, failed = sum(sizes.values()), 0, 0, 0
    with show_share() as show:

        def told(record: JobRecord) -> None:
            nonlocal done, ended, failed
            done, ended, failed = done + sizes[record.name], ended + 1, failed + (record.state == "failed")
            show(f"{ended} of {len(jobs)} recordings, {failed} failed", done / total, record.name)

        yield told


def print_batch(out: Console, records: Sequence[JobRecord], *, everything: bool = False) -> None:
    """Print a row for each recording, of many only for those that did not end well, and the totals."""
    shown = [one for one in records if one.state != "done"] if len(records) > MAX_ROWS and not everything else records
    table = ColumnsTable(
        "", "recording", "state", "frames", "road users", "dropped", "s", "MiB", text_columns=("state",)
    )
    for one in shown:
        users = "" if one.road_users is None else str(sum(one.road_users.values()))
        figures = (str(one.frames), users, str(one.dropped)) if one.state != "failed" else ("", "", "")
        table.add_row(one.name, one.shown_state, *figures, f"{one.wall_s:.1f}", f"{one.peak_mib:.0f}")
    if shown:
        show_table(out, table)
    failed = [one for one in records if one.state == "failed"]
    for one in shown if failed else ():  # the verdict has the first failure, or if there is none, all messages
        if one.message and one is not failed[0]:
            show_line(out, f"{one.name}: {one.message}")
    show_line(out, totals_line(records), "bold")
