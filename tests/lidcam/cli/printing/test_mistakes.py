import io
from typing import Any

import pytest
from rich.console import Console

from lidcam.cli.printing.mistakes import mistake_note, mistakes_table

MISTAKE: dict[str, Any] = {
    "class": "truck",
    "label": None,
    "cause": "nothing",
    "frames": 12,
    "worst_s": 1.25,
    "x_m": -12.34,
    "y_m": 5.0,
    "score": 0.875,
    "lidar_points": None,
}


@pytest.mark.parametrize(
    ("kind", "changes", "note"),
    [
        ("false", {}, "score 0.88, no object there"),
        ("false", {"label": "van", "cause": "class"}, "score 0.88, is a van"),
        ("false", {"label": "van", "cause": "second"}, "score 0.88, second box of a van"),
        ("false", {"label": "van", "cause": "place"}, "score 0.88, too far from its van"),
        ("missed", {"label": "van", "lidar_points": 7}, "van, 7 points"),
        ("missed", {"label": "truck", "lidar_points": 7}, "7 points"),
        ("missed", {"label": "truck"}, "points unknown"),
    ],
)
def test_notes(kind: str, changes: dict[str, Any], note: str) -> None:
    assert mistake_note(kind, MISTAKE | changes) == note


def test_the_worst_three_of_each_kind_fit_a_terminal() -> None:
    kinds = {"false": [MISTAKE | {"frames": count} for count in (12, 9, 5, 4)], "missed": []}
    out = Console(file=io.StringIO(), width=80)
    out.print(mistakes_table("fused", kinds))
    assert isinstance(out.file, io.StringIO)
    lines = out.file.getvalue().splitlines()
    assert lines[0].startswith("worst errors of fused")
    assert max(len(line.rstrip()) for line in lines) <= 80
    assert [line.split()[:6] for line in lines if line.startswith("false")] == [
        ["false", "truck", frames, "1.2", "-12.3", "5.0"] for frames in ("12", "9", "5")
    ]
