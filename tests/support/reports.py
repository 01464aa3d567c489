"""Reports of runs that say something else."""

from dataclasses import replace
from typing import Any

from lidcam.report import RunReport


def changed(report: RunReport, **groups: dict[str, Any]) -> RunReport:
    """A report with other values in its groups, as `inputs={"losses": ()}`."""
    return replace(report, **{name: replace(getattr(report, name), **values) for name, values in groups.items()})
