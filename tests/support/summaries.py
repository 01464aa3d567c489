"""Summaries of runs: as they are printed, and with other values in them."""

from dataclasses import replace
from functools import cache
from io import StringIO
from typing import Any

from helpers import CLUSTERS, SANDBOX
from rich.console import Console

import lidcam
from lidcam.cli.printing.numbers import Units
from lidcam.cli.printing.run import print_details, print_summary
from lidcam.run.summary import RunSummary


@cache
def sound_summary() -> RunSummary:
    """Of a part of the sample, in which nothing is amiss."""
    return lidcam.process(SANDBOX, settings=[CLUSTERS], duration_s=0.3).summary


def printed(summary: RunSummary, *, details: bool = True, units: Units = "km/h", width: int = 0) -> str:
    """All tables and remarks, or the short ones, without blanks at the ends of lines; on a terminal of this width."""
    with StringIO() as out:
        console = Console(width=width or 200, file=out, force_terminal=bool(width), color_system=None)
        if details:
            print_details(console, summary)
        else:
            print_summary(console, summary, units)
        return "\n".join(line.rstrip() for line in out.getvalue().splitlines())


def changed(summary: RunSummary, **groups: dict[str, Any]) -> RunSummary:
    """A summary with other values in its groups, as `inputs={"losses": ()}`."""
    return replace(summary, **{name: replace(getattr(summary, name), **values) for name, values in groups.items()})
