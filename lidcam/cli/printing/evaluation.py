"""Printing of `lidcam evaluate`: a summary in a sentence or two, then tables, then requirements, notes and warnings."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

from lidcam.cli.printing.console import print_remarks, print_warnings
from lidcam.cli.printing.numbers import NONE, number, percent, share, signed
from lidcam.cli.printing.tables import ColumnsTable, rows_table
from lidcam.cli.printing.terminal import show_line, show_table
from lidcam.evaluation.evaluation import Evaluation
from lidcam.evaluation.requirement import Outcome
from lidcam.pipeline.evaluation.evaluation_frame import figure_at

ALL = "all"
"""Name in place of a class: all objects, or the mean of the classes."""

MIN_BLOCKS = 10
"""Fewest blocks of the bootstrap whose interval is wide enough."""

MIN_TRUTH = 10
"""Fewest ground-truth objects of each class of a mean in a headline: one object more or less is no gain."""

AT_50 = ("pedestrian", "bicycle")
"""Classes whose average precision is shown at an IoU of 50 %, others at 70 %: as in KITTI."""

Tree = Mapping[str, Any]


def print_evaluation(out: Console, evaluation: Evaluation, *, everything: bool = False) -> None:
    """Print an evaluation: the headlines and a table of the result by class, or all tables."""
    tree: Tree = evaluation.figures.tree
    show_line(out, _subject(tree, evaluation))
    for headline in headlines(tree):
        show_line(out, headline, "bold")
    tables = (*truth_tables(tree), *own_tables(tree)) if everything else _short_tables(tree)
    for table, explanation in tables:
        if everything:
            out.print()
        show_table(out, table)
        for line in explanation:
            show_line(out, line, "dim")
    if everything and (skew_ms := tree["sync"]["skew_mean_ms"]) is not None:
        out.print()
        show_line(out, f"sync skew: mean {skew_ms:.1f} ms, max {tree['sync']['skew_max_ms']:.1f} ms")
    if evaluation.outcomes:
        out.print()
        show_table(out, _requirements_table(evaluation.outcomes))
    print_remarks(out, (), evaluation.notes)
    print_warnings(out, evaluation.warnings)


def _short_tables(tree: Tree) -> Iterator[tuple[Table, Iterable[str]]]:
    """The figures of the result by class, of classes that have ground truth; without that, its chains."""
    sources: Tree = tree["sources"]
    source = [*sources][-1] if sources else ""
    if not tree["frames_with_truth"] or not source or not sources[source][ALL]["truth"]:
        yield from own_tables(tree)
        return
    tracks = tree["tracking"].get(source, {})
    shown = {
        name: {**figures, **tracks.get(name, {})}
        for name, figures in _with_shown_ap(sources[source]).items()
        if figures["truth"]
    }
    if len(shown) == 2:  # the figures of the only class are those of all
        shown.pop(ALL, None)
    overlap = _overlap(sources[source][ALL], wanted="70")
    low = _overlap(sources[source][ALL], wanted="50")
    table = _figures_table("", (source,), shown.items(), SHORT_COLUMNS if tracks else SHORT_COLUMNS[:-2])
    yield table, (f"AP at {overlap} % IoU ({', '.join(AT_50)} {low} %); mean errors: m, degrees; --all: more",)


def _subject(tree: Tree, evaluation: Evaluation) -> str:
    result, frames = evaluation.inputs[0].name, tree["frames"]
    if evaluation.truth is None:
        return f"{result}: {frames} frames, no ground truth: figures that need it are left out"
    counts = tree["truth_objects"]
    reasons = {"without_class": "of no class", "marked_as_ignored": "marked", "outside": "outside", "unseen": "unseen"}
    ignored = [f"{counts[name]} {words}" for name, words in reasons.items() if counts[name]]
    source = str(evaluation.truth).replace(f" of {result} ", " ")
    return (
        f"{result}: {tree['frames_with_truth']} of {frames} frames have ground truth, from "
        f"{source}; {counts['evaluated']} objects evaluated" + (f", ignored: {', '.join(ignored)}" if ignored else "")
    )


def headlines(tree: Tree) -> list[str]:
    """The main figures in a sentence or two; none without ground-truth objects."""
    return [*filter(None, (_found_headline(tree), _gain_headline(tree)))]


def _found_headline(tree: Tree) -> str:
    """Recall and precision of the last source; empty without ground-truth objects."""
    sources: Tree = tree["sources"]
    if not tree["frames_with_truth"] or not sources:
        return ""
    source = [*sources][-1]
    recall, precision = sources[source][ALL]["recall"], sources[source][ALL]["precision"]
    if recall is None:
        return ""
    right = "it reports no boxes" if precision is None else f"{percent(precision)} of its boxes are correct"
    return f"{source} finds {percent(recall)} of the ground-truth objects; {right}."


def _gain_headline(tree: Tree) -> str:
    """The gain from fusion: the mean of the classes, or that of the commonest one if others are too rare.

    Empty where no camera has 2D boxes, or where there are not two sources to compare.
    """
    if "cameras" not in tree["sources"] or not tree["fusion_gain"]:
        return ""
    truth = {name: one["truth"] for name, one in tree["sources"]["fused"].items() if name != ALL and one["truth"]}
    name = ALL if min(truth.values(), default=0) >= MIN_TRUTH else max(truth, key=lambda one: truth[one], default=ALL)
    gain, ap = _gains(tree["fusion_gain"])[name], "AP" if name == ALL else f"{name} AP"
    if gain["value"] is None or truth.get(name, MIN_TRUTH) < MIN_TRUTH:
        return ""
    value, over = gain["value"], f"{gain['over']} alone"
    if gain["low"] is None:
        verb = f"removes {-value:.2f} {ap} from" if value <= -0.005 else f"adds {max(value, 0.0):.2f} {ap} over"
        return f"Fusion {verb} {over}; too short for a confidence interval."
    interval = f"{signed(gain['low'], 2)} to {signed(gain['high'], 2)}"
    if gain["low"] > 0:
        return f"Fusion adds {value:.2f} {ap} ({interval}) over {over}."
    if gain["takes_away"]:
        return f"Fusion removes {-value:.2f} {ap} ({interval}) from {over}."
    return f"Fusion gains {signed(value, 2)} {ap} ({interval}) over {over}: not significant."


def truth_tables(tree: Tree) -> Iterator[tuple[Table, Iterable[str]]]:
    """Each table of figures that need ground truth, with the lines that explain it."""
    sources: Tree = tree["sources"]
    if tree["frames_with_truth"] and sources:
        shown = {source: _with_shown_ap(classes) for source, classes in sources.items()}
        yield _source_table("detection", shown, DETECTION_COLUMNS), _detection_explained(sources)
        if "cameras" in sources and any(gain["value"] is not None for gain in _gains(tree["fusion_gain"]).values()):
            yield _gain_table(tree["fusion_gain"]), _gain_explained(tree["fusion_gain"])
        yield _source_table("errors of matched boxes (metres, degrees)", sources, ERROR_COLUMNS), ERRORS
    if images := {name: classes[ALL] for name, classes in tree["images"].items() if classes[ALL]["truth"]}:
        overlap = _overlap(next(iter(images.values())), "ap_2d_r40_")
        columns = (*IMAGE_COLUMNS, (f"AP 2D {overlap}", f"ap_2d_r40_{overlap}", share))
        yield _figures_table("2D boxes of all classes", ("camera",), images.items(), columns), ()
    if tree["frames_with_truth"] and (tracking := tree["tracking"]):
        both = {one: {name: {**sources[one][name], **by[name]} for name in by} for one, by in tracking.items()}
        yield _source_table("tracks", tracking, TRACKING_COLUMNS, count="truth_tracks"), ()
        title = "motion and covariance of tracks (m/s, degrees/s)"
        yield _source_table(title, both, MOTION_COLUMNS, count="truth_tracks"), MOTION
    for source, kinds in tree["mistakes"].items():
        if any(kinds.values()):
            yield mistakes_table(source, kinds), ()


def own_tables(tree: Tree) -> Iterator[tuple[Table, Iterable[str]]]:
    """Each table of figures that need no ground truth."""
    title, rows = "without ground truth: chains", dict(tree["unlabelled"])
    for name, one in rows.items():
        if one["objects"]["per_frame_mean"] and not one["chains"]["chains"]:  # its boxes have no tracks
            rows[name] = {**one, "chains": dict.fromkeys(one["chains"])}
    yield _figures_table(title, ("source",), rows.items(), CHAIN_COLUMNS), CHAINS


AP_BEV, AP_3D = "ap_bev_r40_", "ap_3d_r40_"


def _digits(digits: int, form: Callable[..., str] = number) -> Callable[[Any], str]:
    return partial(form, digits=digits)


Columns = Sequence[tuple[str, str, Callable[[Any], str]]]
"""The columns of a table: heading, dotted name of the figure, and format."""

DETECTION_COLUMNS: Columns = (
    ("truth", "truth", str),
    ("boxes", "found", str),
    ("recall", "recall", share),
    ("prec.", "precision", share),
    ("false", "false_per_frame", _digits(2)),
    ("AP bev", AP_BEV, share),
    ("AP 3D", AP_3D, share),
    ("mAP", "distance.map", share),
)
ERROR_COLUMNS: Columns = (
    ("position", "errors.position_bev_m.mean", _digits(3)),
    ("95 %", "errors.position_bev_m.p95", _digits(3)),
    ("heading", "errors.heading_deg.mean", _digits(1)),
    ("flips", "errors.flips", percent),
    ("axis", "errors.heading_mod_180_deg.mean", _digits(1)),
    ("length", "errors.length_m.bias", _digits(2, signed)),
    ("width", "errors.width_m.bias", _digits(2, signed)),
    ("ECE", "calibration.ece", share),
)
ERRORS = (
    "position, heading, axis: means. 95 %: percentile of position. flips: headings off by more than 90 degrees, as "
    "where front and rear are swapped; each adds up to 180 degrees to the mean. axis: heading modulo 180 degrees. "
    "length, width: mean excess. ECE: expected calibration error of the scores.",
)
IMAGE_COLUMNS: Columns = (("truth", "truth", str), ("recall", "recall", share), ("precision", "precision", share))
TRACKING_COLUMNS: Columns = (
    ("HOTA", "hota", share),
    ("DetA", "det_a", share),
    ("AssA", "ass_a", share),
    ("MOTA", "mota", share),
    ("IDF1", "idf1", share),
    ("switches", "id_switches", str),
    ("fragments", "fragmentations", str),
    ("flips", "heading_flips", str),
)
MOTION_COLUMNS: Columns = (
    ("speed", "errors.velocity_m_s.rmse", _digits(2)),
    ("yaw/s", "errors.yaw_rate_deg_s.rmse", _digits(1)),
    ("flips", "errors.flips_moving", percent),
    ("NEES", "errors.nees.mean", _digits(1)),
    ("in 95 %", "errors.nees.inside_95", percent),
    ("pred.", "predicted.nees.inside_95", percent),
    ("false", "false_tracks", str),
    ("lasting", "false_track_s_mean", _digits(1)),
)
MOTION = (
    "speed, yaw/s: RMS errors over ground. flips: moving objects whose heading is off by more than 90 degrees. NEES: "
    "normalised squared position error; 2 on average if the covariance is right. in 95 %: inside the 95 % ellipse; "
    "pred.: predicted ones only. false: tracks that mostly match nothing; lasting: their mean duration, seconds.",
)
SHORT_COLUMNS: Columns = (
    ("truth", "truth", str),
    ("recall", "recall", share),
    ("prec.", "precision", share),
    ("AP bev", AP_BEV, share),
    ("AP 3D", AP_3D, share),
    ("position", "errors.position_bev_m.mean", _digits(2)),
    ("heading", "errors.heading_deg.mean", _digits(1)),
    ("HOTA", "hota", share),
    ("IDF1", "idf1", share),
)
CHAIN_COLUMNS: Columns = (
    ("objects/frame", "objects.per_frame_mean", _digits(1)),
    ("chains", "chains.chains", _digits(0)),
    ("seconds", "chains.seconds_mean", _digits(1)),
    ("missing", "chains.missing_share", percent),
    ("flickers", "chains.flickers", _digits(0)),
    ("relabelled", "chains.class_changes", _digits(0)),
    ("flips", "chains.heading_flips", _digits(0)),
)
CHAINS = (
    "chain: boxes of one object over time. seconds: mean length. missing: share of frames between first and last. "
    "flickers: gaps of a few frames. relabelled, flips: changes between frames.",
)


def _with_shown_ap(classes: Tree) -> Tree:
    """The figures by class, with the average precisions that are shown: of all, the mean over the classes."""
    found = {name: {**figures, **shown_ap(name, figures)} for name, figures in classes.items()}
    for view in (AP_BEV, AP_3D):
        known = [one[view] for name, one in found.items() if name != ALL and one[view] is not None]
        found[ALL][view] = sum(known) / len(known) if known else None
    return found


def shown_ap(name: str, figures: Tree) -> dict[str, float | None]:
    """Average precision of a class at the IoU at which it is shown, from above and in 3D, by `AP_BEV` and `AP_3D`."""
    overlap = _overlap(figures, wanted="50" if name in AT_50 else "70")
    return {view: figures[f"{view}{overlap}"] for view in (AP_BEV, AP_3D)}


def _detection_explained(sources: Tree) -> Iterator[str]:
    """The meanings of the columns, and the rule by which a box matches."""
    classes = next(iter(sources.values()))
    small, large = (_overlap(classes[ALL], wanted=overlap) for overlap in ("50", "70"))
    overlaps = f"{large} %" if small == large else f"{large} % ({' and '.join(AT_50)}: {small} %)"
    yield (
        "boxes: reported. false: wrong boxes per frame. AP bev, AP 3D: average precision seen from above and in 3D, 40 "
        f"recalls, at an IoU of {overlaps}. mAP: mean over four matching distances, scaled by the length of the class:"
    )
    for name, figures in classes.items():
        if name != ALL and (thresholds := figures["distance"].get("thresholds")):
            distances = [f"{threshold['distance_m']:.3g}" for threshold in thresholds]
            yield f"  {name}: {', '.join(distances)} m"
    yield (
        "A box matches if its centre, seen from above, is within the third of these distances of an unmatched "
        "ground-truth object of its class. recall: share of those objects matched. prec.: share of boxes matched."
    )


def _gain_table(gains: Tree) -> Table:
    columns = ("AP bev", "from", "to", "AP 3D", "prec.", "recall", "position")
    table = ColumnsTable("gain from fusion, 95 % interval", "class", "over", *columns, text_columns=("over",))
    shown = {name: best for name, best in _gains(gains).items() if best["value"] is not None}
    if len(shown) == 2:
        shown.pop(ALL, None)
    for name, best in shown.items():
        one = gains[name]
        others = (_gains(gains, AP_3D)[name], one["precision"], one["recall"])
        table.add_row(
            name,
            best["over"],
            *(signed(best[key], 2) for key in ("value", "low", "high")),
            *(signed(other["value"], 2) for other in others),
            signed(one["errors"]["position_bev_m"]["mean"]["value"], 3),
        )
    return table


def _gains(gains: Tree, view: str = AP_BEV) -> dict[str, Any]:
    """The gain in average precision, by class."""
    return {name: one[f"{view}{_overlap(one)}"] for name, one in gains.items()}


def _gain_explained(gains: Tree) -> Iterator[str]:
    blocks, overlap = gains[ALL]["blocks"], _overlap(gains[ALL])
    yield f"over: the better single sensor. + is better, also for position. AP: at an IoU of {overlap} %."
    if _gains(gains)[ALL]["low"] is None:
        yield f"There is no interval: a recording of {blocks} s is too short for resampling."
    elif blocks < MIN_BLOCKS:
        yield f"The interval is too narrow: a recording of {blocks} s is short for resampling."


def _requirements_table(outcomes: Sequence[Outcome]) -> Table:
    table = ColumnsTable("required", "figure", "expected", "found", "", text_columns=("",))
    for outcome in outcomes:
        asked = outcome.requirement
        found, met = NONE if outcome.found is None else f"{outcome.found:.4g}", "not met" if outcome.failure else "met"
        table.add_row(asked.name, f"{asked.sign} {asked.limit:g}", found, met)
    return table


def _source_table(title: str, sources: Tree, columns: Columns, count: str = "truth") -> Table:
    """A row for each class and source, of classes that the truth or a source has; the class is named once."""
    names = next(iter(sources.values()))
    shown = [name for name in names if any(one[name][count] or one[name].get("found") for one in sources.values())]
    if len(shown) == 2 and ALL in shown:  # the figures of the only class are those of all
        shown.remove(ALL)
    rows = [
        (("" if row else name, source), one[name])
        for name in shown
        for row, (source, one) in enumerate(sources.items())
    ]
    return _figures_table(title, ("class", "source"), rows, columns)


def _figures_table(
    title: str, first: tuple[str, ...], rows: Iterable[tuple[str | tuple[str, ...], Tree]], columns: Columns
) -> Table:
    """A row for each tree of figures, after its names."""
    table = ColumnsTable(title, *first, *(heading for heading, _, _ in columns), text_columns=first)
    for names, tree in rows:
        cells = (form(figure_at(tree, path)) for _, path, form in columns)
        table.add_row(*((names,) if isinstance(names, str) else names), *cells)
    return table


def _overlap(figures: Tree, beginning: str = AP_BEV, wanted: str = "50") -> str:
    """The IoU that is shown, in percent: the wanted one if that is among them, else the last."""
    known = [key.removeprefix(beginning) for key in figures if key.startswith(beginning)]
    return wanted if wanted in known else known[-1]


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
    rows = list[tuple[object, ...]]()
    for kind, mistakes in kinds.items():
        for one in mistakes[:MAX_PRINTED]:
            where = (f"{one[key]:.1f}" for key in ("worst_s", "x_m", "y_m"))
            rows.append((kind, one["class"], one["frames"], *where, mistake_note(kind, one)))
    title = f"worst errors of {source}: where to look, and when (s from the first frame)"
    return rows_table(title, ("error", "class", "frames", "at s", "x m", "y m", ""), rows, ("class", ""))


def mistake_note(kind: str, mistake: Mapping[str, Any]) -> str:
    """The object at the place of a false detection, or the lidar points of a missed object."""
    if kind == "missed":
        points = mistake["lidar_points"]
        own = "" if mistake["label"] == mistake["class"] else f"{mistake['label']}, "
        return f"{own}{'points unknown' if points is None else f'{points} points'}"
    return f"score {mistake['score']:.2f}, {CAUSES[mistake['cause']].format(label=mistake['label'])}"
