"""The worst errors of a result, so that one can look at them."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from lidcam.cli.printing.tables import ColumnsTable

MAX_PRINTED = 3
"""Of each kind; the JSON has more."""


CAUSES = {
    "nothing": "no object there",
    "class": "is a {label}",
    "second": "second box of a {label}",
    "place": "too far from its {label}",
}


def mistakes_table(source: str, kinds: Mapping[str, Any]) -> Table:
    """The worst mistakes of one source: what, in how many frames, when and where it is worst."""
    title = f"worst errors of {source}: where to look, and when (s from the first frame)"
    table = ColumnsTable(title, "error", "class", "frames", "at s", "x m", "y m", "", text_columns=("class", ""))
    for kind, mistakes in kinds.items():
        for one in mistakes[:MAX_PRINTED]:
            place = (f"{one[axis]:.1f}" for axis in ("x_m", "y_m"))
            note = mistake_note(kind, one)
            table.add_row(kind, one["class"], str(one["frames"]), f"{one['worst_s']:.1f}", *place, note)
    return table


def mistake_note(kind: str, mistake: Mapping[str, Any]) -> str:
    """The object at the place of a false detection, or the lidar points of a missed object."""
    if kind == "missed":
        points = mistake["lidar_points"]
        own = "" if mistake["label"] == mistake["class"] else f"{mistake['label']}, "
        return f"{own}{'points unknown' if points is None else f'{points} points'}"
    return f"score {mistake['score']:.2f}, {CAUSES[mistake['cause']].format(label=mistake['label'])}"
