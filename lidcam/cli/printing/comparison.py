"""Printing of `lidcam compare`."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from lidcam.cli.printing.tables import rows_table
from lidcam.cli.printing.terminal import show_line, show_table
from lidcam.pipeline.evaluation.comparison.object_changes import KINDS, TOLERANCES

ALL = "all"
_UNITS = {"moved": " m", "turned": " deg", "resized": " m"}


def print_comparison(out: Console, figures: Mapping[str, Any], names: Sequence[str], *, lines: int) -> None:
    """Print the comparison of two results with these names, and at most `lines` differences."""
    show_line(out, f"A  {names[0]}")
    show_line(out, f"B  {names[1]}")
    show_line(
        out,
        f"frames: {figures['frames']} in both, {figures['frames_different']} of them differ; "
        f"{figures['frames_only_in_a']} only in A, {figures['frames_only_in_b']} only in B",
    )
    show_line(out, f"tolerances: {', '.join(f'{name} {value:g}' for name, value in TOLERANCES.items())}", "dim")
    out.print()
    _print_counts(out, "objects", "source", figures["sources"])
    if figures["images"]:
        _print_counts(out, "2D boxes", "camera", figures["images"])
    _print_differences(out, figures["differences"], lines)


def _print_counts(out: Console, title: str, first: str, channels: Mapping[str, Any]) -> None:
    """The objects by source or camera, and by class where something differs; kinds that do not occur have no column."""
    kinds = [kind for kind in KINDS if any(counts[ALL][kind] for counts in channels.values())]
    rows = (
        (name, class_name, row["a"], row["b"], row["equal"], *(row[kind] or "" for kind in kinds))
        for name, by_class in channels.items()
        for class_name, row in _shown(by_class).items()
    )
    show_table(out, rows_table(title, (first, "class", "A", "B", "equal", *kinds), rows, ("class",)))
    out.print()


def _shown(by_class: Mapping[str, Any]) -> Mapping[str, Any]:
    """The rows of a source or camera: one where all classes are equal, or there is only one."""
    if len(by_class) == 2:
        return {key: row for key, row in by_class.items() if key != ALL}
    return by_class if any(by_class[ALL][kind] for kind in KINDS) else {ALL: by_class[ALL]}


def _print_differences(out: Console, differences: Mapping[str, Any], lines: int) -> None:
    listed, count = differences["listed"][:lines], differences["count"]
    if not count or not lines:
        return
    title = "differences" if len(listed) == count else f"the first {len(listed)} of {count} differences"
    rows = []
    for one in listed:
        frames = f"{one['first_frame']}-{one['last_frame']}" if one["frames"] > 1 else one["first_frame"]
        span = f"{one['first_s']:.3f}", f"{one['last_s']:.3f}"
        place = ", ".join(f"{value:.{0 if 'camera' in one else 2}f}" for value in one["place"])  # pixels or metres
        rows.append((one.get("source") or one["camera"], one["class"], _what(one), frames, *span, place))
    columns = ("in", "class", "difference", "frames", "from s", "to s", "at")
    show_table(out, rows_table(title, columns, rows, ("class", "difference", "at")))
    out.print()


def _what(one: Mapping[str, Any]) -> str:
    """All that differs, and in how many of the frames if not in all of them."""
    parts = []
    for kind, found in one["kinds"].items():
        amount = one["new_class"] if kind == "relabelled" else ""
        if found["largest"] is not None:
            amount = _amount(kind, found["largest"], is_image="camera" in one)
        sometimes = f" in {found['frames']} frames" if found["frames"] < one["frames"] else ""
        parts.append(f"{kind} {amount}".rstrip() + sometimes)
    return ", ".join(parts)


def _amount(kind: str, amount: float, *, is_image: bool) -> str:
    if kind in {"lost", "new"}:
        return f"(score {amount:.2f})"
    if is_image and kind == "moved":
        return f"{amount:.1f} px"
    return f"{amount:.3f}{_UNITS.get(kind, '')}"
