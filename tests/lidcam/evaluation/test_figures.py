"""Figures by their names."""

from typing import Any

import pytest

from lidcam.evaluation.figures import NamedFigures

TREE: dict[str, Any] = {
    "sources": {
        "fused": {
            "car": {"recall": 0.84, "ap_bev_r40_50": 0.9, "ap_3d_r40_50": None, "ranges": {"0_20": {"recall": 1}}}
        },
        "lidar": {"car": {"recall": 0.5}},
    },
    "thresholds": {"car_m": [0.5, 1.0]},
    "frames": 3,
}
FIGURES = NamedFigures(TREE)


@pytest.mark.parametrize(
    ("name", "figure"),
    [
        ("sources.fused.car.recall", 0.84),
        ("fused.car.recall", 0.84),
        ("fused.car.ranges.0_20.recall", 1),
        ("thresholds.car_m.1", 1.0),
        ("frames", 3),
    ],
)
def test_a_figure_by_its_name(name: str, figure: float | None) -> None:
    assert name in FIGURES
    assert len(FIGURES) == 8
    assert FIGURES[name] == figure
    assert FIGURES.get(name, "none") == figure


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("fused.car.recal", "unknown figure 'fused.car.recal': did you mean 'fused.car.recall'"),
        ("fuzed.car.ap_bev_50", "'fused.car.ap_bev_r40_50'"),
        ("fused.car.ap", "did you mean 'fused.car.ap_bev_r40_50' or 'fused.car.ap_3d_r40_50'?"),
        ("fused.car", "'fused.car' names 4 figures: expected one of them, such as 'fused.car.recall'"),
        ("xyz", "unknown figure 'xyz': known are those of sources, thresholds, frames"),
        ("", "unknown figure '': known are"),
    ],
)
def test_an_unknown_name_is_answered_with_the_nearest(name: str, told: str) -> None:
    assert name not in FIGURES
    assert FIGURES.get(name) is None
    assert told in FIGURES.unknown(name)
    with pytest.raises(KeyError, match="figure"):
        FIGURES[name]
