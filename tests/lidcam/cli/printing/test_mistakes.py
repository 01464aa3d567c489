from typing import Any

import pytest

from lidcam.cli.printing.mistakes import mistake_note

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
        ("missed", {"label": "truck", "lidar_points": 7}, "7 points"),
        ("missed", {"label": "truck"}, "points unknown"),
    ],
)
def test_notes(kind: str, changes: dict[str, Any], note: str) -> None:
    assert mistake_note(kind, MISTAKE | changes) == note
