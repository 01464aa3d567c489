"""What `lidcam evaluate` prints: what it comes to in a sentence, then tables, then what to mind."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from lidcam.evaluation.evaluation import Evaluation
from lidcam.evaluation.requirement import Outcome
from lidcam.printing.folding import show_line, show_table
from lidcam.printing.mistakes import mistakes_table
from lidcam.printing.tables import columns_table

__all__ = ["print_evaluation"]

ALL = "all"
"""In place of a class: the figure of all objects, or the mean of the classes."""

NONE = "-"
"""In place of a figure that is not defined."""

ORDER = ("lidar", "cameras", "fused")
"""Of the sources: what is made of others comes last."""

Tree = Mapping[str, Any]


def print_evaluation(out: Console, evaluation: Evaluation) -> None:
    """The report of an evaluation."""
    tree: Tree = evaluation.figures.tree
    show_line(out, _subject(tree, evaluation))
    for table in _tables(tree):
        out.print()
        show_table(out, table)
    out.print()
    for line in _explained(tree):
        show_line(out, line, "dim")
    if evaluation.outcomes:
        out.print()
        show_table(out, _requirements_table(evaluation.outcomes))
    for note in evaluation.notes:
        show_line(out, f"note: {note}")
    for warning in evaluation.warnings:
        show_line(out, f"warning: {warning}", "yellow")


def _subject(tree: Tree, evaluation: Evaluation) -> str:
    result, frames = evaluation.inputs[0].name, tree["frames"]
    if evaluation.truth is None:
        return f"{result}: {frames} frames, without truth: what needs it is not measured"
    counts = tree["truth_objects"]
    reasons = {"without_class": "of no class", "marked_as_ignored": "marked", "outside": "outside", "unseen": "unseen"}
    ignored = [f"{counts[name]} {words}" for name, words in reasons.items() if counts[name]]
    return (
        f"{result}: {tree['frames_with_truth']} of {frames} frames have truth, from "
        f"{' and '.join(evaluation.truth.sources)}; {counts['evaluated']} true objects count"
        + (f", ignored: {', '.join(ignored)}" if ignored else "")
    )


def _tables(tree: Tree) -> Iterator[Table]:
    sources: Tree = tree.get("sources", {})
    if tree["frames_with_truth"] and sources:
        yield _found_table(sources)
        yield _errors_table(sources)
    if tree["frames_with_truth"] and tree.get("fusion_gain"):
        yield _gain_table(tree["fusion_gain"], sources)
    if images := [name for name, classes in tree.get("images", {}).items() if classes[ALL]["truth"]]:
        yield _images_table({name: tree["images"][name] for name in images})
    if tree["frames_with_truth"] and tree.get("tracking"):
        yield _tracking_table(tree["tracking"])
    for source, kinds in tree.get("mistakes", {}).items():
        if any(kinds.values()):
            yield mistakes_table(source, kinds)


def _found_table(sources: Tree) -> Table:
    overlap = _overlap(sources)
    columns = ("truth", "found", "recall", "prec.", "false", "AP bev", "AP 3D", "mAP")
    table = columns_table("detection", "class", "source", *columns, text_columns=("source",))
    for name, source, figures in _rows(sources):
        table.add_row(
            name,
            source,
            str(figures["truth"]),
            str(figures["found"]),
            _share(figures["recall"]),
            _share(figures["precision"]),
            _number(figures["false_per_frame"], 2),
            _share(figures[f"ap_bev_r40_{overlap}"]),
            _share(figures[f"ap_3d_r40_{overlap}"]),
            _share(figures[_by_distance(sources)]["map"]),
        )
    return table


def _errors_table(sources: Tree) -> Table:
    columns = ("position", "95 %", "heading", "95 %", "flips", "length", "width", "ECE")
    table = columns_table(
        "errors of what was found (metres, degrees)", "class", "source", *columns, text_columns=("source",)
    )
    for name, source, figures in _rows(sources):
        errors = figures["errors"]
        table.add_row(
            name,
            source,
            *(_number(errors["position_bev_m"][key], 3) for key in ("mean", "p95")),
            *(_number(errors["heading_deg"][key], 1) for key in ("mean", "p95")),
            _percent(errors["flips"]),
            *(_signed(errors[key]["bias"], 2) for key in ("length_m", "width_m")),
            _share(figures["calibration"]["ece"]),
        )
    return table


def _gain_table(gains: Tree, sources: Tree) -> Table:
    overlap, by_distance = _overlap({"fused": gains}), _by_distance(sources)
    table = columns_table("what fusion adds", "class", "AP bev", "mAP", "F1")
    shown = {name: gain for name, gain in gains.items() if gain["f1"]["value"] is not None}
    if len(shown) == 2:  # what is said of the only class is said of all
        del shown[ALL]
    for name, gain in shown.items():
        compared = (gain[f"ap_bev_r40_{overlap}"], gain[by_distance]["map"], gain["f1"])
        table.add_row(name, *map(_interval, compared))
    return table


def _images_table(images: Tree) -> Table:
    overlap = _overlap(images, "ap_2d_r40_")
    table = columns_table("2D boxes of all classes", "camera", "truth", "recall", "precision", f"AP 2D {overlap}")
    for camera, classes in images.items():
        figures = classes[ALL]
        shares = (figures["recall"], figures["precision"], figures[f"ap_2d_r40_{overlap}"])
        table.add_row(camera, str(figures["truth"]), *map(_share, shares))
    return table


def _tracking_table(tracking: Tree) -> Table:
    columns = ("HOTA", "DetA", "AssA", "MOTA", "IDF1", "switches", "fragments", "flips")
    table = columns_table("tracks", "class", "source", *columns, text_columns=("source",))
    for name, source, figures in _rows(tracking, count="truth_tracks"):
        shares = (figures[key] for key in ("hota", "det_a", "ass_a", "mota", "idf1"))
        counts = (figures[key] for key in ("id_switches", "fragmentations", "heading_flips"))
        table.add_row(name, source, *map(_share, shares), *map(str, counts))
    return table


def _requirements_table(outcomes: Sequence[Outcome]) -> Table:
    table = columns_table("required", "figure", "expected", "found", "", text_columns=("",))
    for outcome in outcomes:
        asked = outcome.requirement
        found = NONE if outcome.found is None else f"{outcome.found:.4g}"
        table.add_row(asked.name, f"{asked.sign} {asked.limit:g}", found, "not met" if outcome.failure else "met")
    return table


def _explained(tree: Tree) -> Iterator[str]:
    """What the names above columns mean, and what counts as right."""
    sources: Tree = tree.get("sources", {})
    if not (tree["frames_with_truth"] and sources):
        return
    by_distance = _by_distance(sources)
    at = "as nuScenes has it." if by_distance == "nuscenes" else "at four that go with the length of the class:"
    yield (
        "false: false boxes a frame. AP bev, AP 3D: average precision from above and in 3D at an IoU of "
        f"{_overlap(sources)} %, 40 recalls. mAP: the mean of those by distance of the centres, {at}"
    )
    for name, classes in _distances(sources, by_distance).items():
        yield f"  {name}: {classes}"
    yield (
        "recall, prec., errors: of what lies within the third of these. 95 %: of the errors are smaller. flips: "
        "headings wrong by more than 90 degrees. length, width: by how much too long and too wide. ECE: how far scores "
        "are from the share that is right."
    )
    if tree.get("fusion_gain"):
        yield (
            "what fusion adds: to the better of the other sources; F1 is that of precision and recall. The interval of "
            "95 % comes from drawing seconds of the result anew, and is left out where there are fewer than five."
        )


def _distances(sources: Tree, by_distance: str) -> dict[str, str]:
    """The distances by class."""
    found = {}
    for name, figures in next(iter(sources.values())).items():
        if name != ALL and (thresholds := figures[by_distance].get("thresholds")):
            found[name] = ", ".join(f"{threshold['distance_m']:.3g}" for threshold in thresholds) + " m"
    return found


def _rows(sources: Tree, count: str = "truth") -> Iterator[tuple[str, str, Tree]]:
    """Class, source and figures, of classes that the truth or a source has; the class is named once."""
    ordered = sorted(sources, key=lambda source: (ORDER.index(source) if source in ORDER else len(ORDER), source))
    by_class = {name: {source: sources[source][name] for source in ordered} for name in sources[ordered[0]]}
    shown = {
        name: figures
        for name, figures in by_class.items()
        if any(one[count] or one.get("found") for one in figures.values())
    }
    if ALL in shown and len(shown) == 2:  # what is said of the only class is said of all
        del shown[ALL]
    for name, figures in shown.items():
        for row, (source, one) in enumerate(figures.items()):
            yield "" if row else name, source, one


def _overlap(sources: Tree, beginning: str = "ap_bev_r40_") -> str:
    """The IoU that is shown, in percent: 50 if that is among them."""
    figures = next(iter(sources.values()))[ALL]
    known = [key.removeprefix(beginning) for key in figures if key.startswith(beginning)]
    return "50" if "50" in known else known[0]


def _by_distance(sources: Tree) -> str:
    return "nuscenes" if "nuscenes" in next(iter(sources.values()))[ALL] else "distance"


def _share(value: float | None) -> str:
    return _number(value, 2)


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{100 * value:.0f} %"


def _number(value: float | None, digits: int) -> str:
    return NONE if value is None else f"{value:.{digits}f}"


def _interval(gain: Tree) -> str:
    if gain["low"] is None:
        return _signed(gain["value"], 2)
    return f"{gain['value']:+.2f} ({gain['low']:+.2f}, {gain['high']:+.2f})"


def _signed(value: float | None, digits: int) -> str:
    return NONE if value is None else f"{value:+.{digits}f}"
