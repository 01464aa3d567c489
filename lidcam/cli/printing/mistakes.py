"""The worst errors of a result, to be looked up in a viewer."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from lidcam.cli.printing.tables import rows_table

MAX_PRINTED = 3
"""Mistakes of each kind that are printed; the JSON has more."""


CAUSES = {
    "nothing": "no object there",
    "class": "is a {label}",
    "second": "second box of a {label}",
    "place": "too far from its {label}",
}


def mistakes_table(source: str, kinds: Mapping[str, Any]) -> Table:
    """The worst mistakes of one source: kind, number of frames, time and place."""
    rows = (
        (
            kind,
            one["class"],
            one["frames"],
            *(f"{one[key]:.1f}" for key in ("worst_s", "x_m", "y_m")),
            mistake_note(kind, one),
        )
        for kind, mistakes in kinds.items()
        for one in mistakes[:MAX_PRINTED]
    )
    title = f"worst errors of {source}: where to look, and when (s from the first frame)"
    return rows_table(title, ("error", "class", "frames", "at s", "x m", "y m", ""), rows, ("class", ""))


def mistake_note(kind: str, mistake: Mapping[str, Any]) -> str:
    """The object at the place of a false detection, or the lidar points of a missed object."""
    if kind == "missed":
        points = mistake["lidar_points"]
        own = "" if mistake["label"] == mistake["class"] else f"{mistake['label']}, "
        return f"{own}{'points unknown' if points is None else f'{points} points'}"
    return f"score {mistake['score']:.2f}, {CAUSES[mistake['cause']].format(label=mistake['label'])}"
