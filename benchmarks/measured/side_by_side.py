"""Tables with all sources side by side, and whether fusion is better than the better single sensor."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from pages import table

from lidcam.printing.numbers import NONE, number, share, signed

Tree = Mapping[str, Any]

FOUND: Mapping[str, Callable[[Tree], str]] = {
    "AP bev": lambda one: share(one["ap_bev_r40_50"]),
    "F1": lambda one: share(one["f1"]),
    "false": lambda one: share(one["false_per_frame"]),
}
PLACED: Mapping[str, Callable[[Tree], str]] = {
    "position": lambda one: number(one["errors"]["position_bev_m"]["mean"], 2),
    "heading": lambda one: number(one["errors"]["heading_mod_180_deg"]["p50"], 1),
    "ECE": lambda one: share(one["calibration"]["ece"]),
}
"""Columns of the two tables, and how each figure stands there."""

GAINS = {"AP bev": "ap_bev_r40_50", "F1": "f1", "position": "errors.position_bev_m.mean"}
"""Figures in which fusion should be better, by their names in the JSON."""


def side_by_side(figures: Tree) -> Iterator[str]:
    """Figures of detection and of placement: a row for each class, the sources beside one another."""
    sources: Tree = figures["sources"]
    for columns in (FOUND, PLACED):
        head = [f"{column}, {source}" for column in columns for source in sources]
        rows = [
            [name, f"{next(iter(sources.values()))[name]['truth']}"]
            + [shown(sources[source][name]) for shown in columns.values() for source in sources]
            for name in classes_met(figures)
        ]
        yield from table(["class", "truth", *head], rows)


def verdicts(figures: Tree) -> Iterator[str]:
    """Whether fusion is better than the better single sensor, by class and figure, with the interval of 95 %."""
    names = [name for name in classes_met(figures) if figures["fusion_gain"][name]["recall"]["value"] is not None]
    singles = [source for source in figures["sources"] if source != "fused"]
    rows = [
        [name]
        + [_verdict(_named(figures["fusion_gain"][name], key)) for key in GAINS.values()]
        + [_verdict(figures["fusion_gain"][name]["same_objects"][single]) for single in singles]
        for name in names
    ]
    yield from table(["class", *GAINS, *(f"position, found by {single}, too" for single in singles)], rows)


def _verdict(gain: Tree) -> str:
    if gain["value"] is None:
        return NONE
    value = signed(gain["value"], 2) + (f" over {gain['over']}" if "over" in gain else "")
    if gain["low"] is None:
        return value
    certain = "better" if gain["low"] > 0 else "worse" if gain["high"] < 0 else "open"
    return f"{certain}: {value} ({signed(gain['low'], 2)} to {signed(gain['high'], 2)})"


def _named(tree: Tree, name: str) -> Tree:
    for part in name.split("."):
        tree = tree[part]
    return tree


def classes_met(figures: Tree) -> list[str]:
    """Classes with truth or detections, and all of them together if there are several."""
    sources: Tree = figures["sources"]
    met = [
        name
        for name in next(iter(sources.values()))
        if any(classes[name][count] for classes in sources.values() for count in ("truth", "found"))
    ]
    return met[:1] if len(met) == 2 else met


def by_class(figures: Tree) -> Iterator[tuple[str, str, Tree]]:
    """Class, source and figures: the classes that were met, each with all sources."""
    for name in classes_met(figures):
        yield from ((name, source, classes[name]) for source, classes in figures["sources"].items())
