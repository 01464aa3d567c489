"""Printing of `lidcam evaluate`: a summary in a sentence or two, then tables, then requirements, notes and warnings."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from lidcam.cli.printing.folding import show_line, show_table
from lidcam.cli.printing.mistakes import mistakes_table
from lidcam.cli.printing.numbers import NONE, number, percent, share, signed
from lidcam.cli.printing.tables import ColumnsTable
from lidcam.evaluation.evaluation import Evaluation
from lidcam.evaluation.requirement import Outcome

ALL = "all"
"""In place of a class: the figure of all objects, or the mean of the classes."""

MIN_BLOCKS = 10
"""From which on an interval is as wide as it should be."""

Tree = Mapping[str, Any]
Columns = Mapping[str, Callable[[Any], str]]
"""The columns of a table, and how the cell of each is made of the figures of a class and source."""


def print_evaluation(out: Console, evaluation: Evaluation) -> None:
    """The report of an evaluation."""
    tree: Tree = evaluation.figures.tree
    show_line(out, _subject(tree, evaluation))
    for headline in headlines(tree):
        show_line(out, headline, "bold")
    for table, explanation in (*truth_tables(tree), *own_tables(tree)):
        out.print()
        show_table(out, table)
        for line in explanation:
            show_line(out, line, "dim")
    if (skew_ms := tree["sync"]["skew_mean_ms"]) is not None:
        out.print()
        show_line(out, f"sync skew: {skew_ms:.1f} ms mean, {tree['sync']['skew_max_ms']:.1f} ms at most")
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


def _whole(tree: Tree) -> str:
    """How much the last source finds, in a sentence; nothing without true objects."""
    sources: Tree = tree["sources"]
    if not tree["frames_with_truth"] or not sources:
        return ""
    source = [*sources][-1]
    figures = sources[source][ALL]
    if figures["recall"] is None:
        return ""
    right = (
        "it reports no box"
        if figures["precision"] is None
        else f"{percent(figures['precision'])} of its boxes are right"
    )
    return f"{source} finds {percent(figures['recall'])} of the true objects; {right}."


def _headline(tree: Tree) -> str:
    """The gain of fusion in a sentence; empty where there are not two sources to compare."""
    gains = tree["fusion_gain"].get(ALL, {})
    gain = gains.get(_gain_name(gains), {}) if gains else {}
    if gain.get("value") is None:
        return ""
    value, over = gain["value"], f"{gain['over']} alone, seen from above"
    if gain["low"] is None:
        does = f"takes away {-value:.2f} AP from" if value <= -0.005 else f"adds {max(value, 0.0):.2f} AP over"
        return f"Fusion {does} {over}; the recording is too short to say how sure that is."
    interval = f"{signed(gain['low'], 2)} to {signed(gain['high'], 2)}"
    if gain["low"] > 0:
        return f"Fusion adds {value:.2f} AP ({interval}) over {over}."
    if gain["takes_away"]:
        return f"Fusion takes away {-value:.2f} AP ({interval}) from {over}."
    return f"Fusion neither adds nor takes away AP for sure: {signed(value, 2)} ({interval}) over {over}."


def headlines(tree: Tree) -> list[str]:
    """What the figures come to, in a sentence or two; none without true objects."""
    return [*filter(None, (_whole(tree), _headline(tree)))]


def truth_tables(tree: Tree) -> Iterator[tuple[Table, Iterable[str]]]:
    """Each table of figures that need truth, with the lines that explain it."""
    sources: Tree = tree["sources"]
    if tree["frames_with_truth"] and sources:
        yield _found_table(sources), _detection_explained(sources)
        if any(gains[_gain_name(gains)]["value"] is not None for gains in tree["fusion_gain"].values()):
            yield _gain_table(tree["fusion_gain"]), _gain_explained(tree["fusion_gain"])
        yield _errors_table(sources), _ERRORS
    if images := [name for name, classes in tree["images"].items() if classes[ALL]["truth"]]:
        yield _images_table({name: tree["images"][name] for name in images}), ()
    if tree["frames_with_truth"] and tree["tracking"]:
        yield _tracking_table(tree["tracking"]), ()
        yield _motion_table(sources, tree["tracking"]), _MOTION
    for source, kinds in tree["mistakes"].items():
        if any(kinds.values()):
            yield mistakes_table(source, kinds), ()


def own_tables(tree: Tree) -> Iterator[tuple[Table, Iterable[str]]]:
    """Each table of figures that need none."""
    yield _chains_table(tree["unlabelled"]), _CHAINS


_ERRORS = (
    "position, heading, axis: means. 95 %: of the boxes are nearer. flips: headings off by more than 90 degrees, as "
    "where front and rear are exchanged; each adds up to 180 degrees to the mean. axis: the heading if front and rear "
    "are not told apart. length, width: by how much too long and too wide. ECE: how far scores are from the share that "
    "is right.",
)
_MOTION = (
    "speed, yaw/s: errors over the ground, in the root of the mean square. flips: headings off by more than 90 degrees "
    "of what moves. NEES: squared error over what the covariance lets expect, 2 in the mean. in 95 %: boxes that it "
    "holds as it should; pred.: of those that were predicted. false, lasting: tracks that mostly match nothing, and "
    "for how many seconds.",
)
_CHAINS = (
    "chain: boxes of one track. seconds: its mean length. missing: of the frames "
    "between the first and the last of a chain. flickers: gaps of a frame or few. relabelled, flips: from one frame to "
    "the next.",
)


def _found_table(sources: Tree) -> Table:
    overlap, by_distance = _overlap(sources), _by_distance(sources)
    columns: Columns = {
        "truth": lambda one: str(one["truth"]),
        "boxes": lambda one: str(one["found"]),
        "recall": lambda one: share(one["recall"]),
        "prec.": lambda one: share(one["precision"]),
        "false": lambda one: number(one["false_per_frame"], 2),
        "AP bev": lambda one: share(one[f"ap_bev_r40_{overlap}"]),
        "AP 3D": lambda one: share(one[f"ap_3d_r40_{overlap}"]),
        "mAP": lambda one: share(one[by_distance]["map"]),
    }
    return _source_table("detection", sources, columns)


def _gain_table(gains: Tree) -> Table:
    columns = ("AP bev", "from", "to", "AP 3D", "prec.", "recall", "position")
    table = ColumnsTable("gain by fusion, with its interval of 95 %", "class", "over", *columns, text_columns=("over",))
    shown = {name: one for name, one in gains.items() if one[_gain_name(one)]["value"] is not None}
    if len(shown) == 2:
        shown.pop(ALL, None)
    for name, one in shown.items():
        best = one[_gain_name(one)]
        others = (one[_gain_name(one, "ap_3d_r40_")], one["precision"], one["recall"])
        table.add_row(
            name,
            best["over"],
            *(signed(best[key], 2) for key in ("value", "low", "high")),
            *(signed(other["value"], 2) for other in others),
            signed(one["errors"]["position_bev_m"]["mean"]["value"], 3),
        )
    return table


def _errors_table(sources: Tree) -> Table:
    columns: Columns = {
        "position": lambda one: number(one["errors"]["position_bev_m"]["mean"], 3),
        "95 %": lambda one: number(one["errors"]["position_bev_m"]["p95"], 3),
        "heading": lambda one: number(one["errors"]["heading_deg"]["mean"], 1),
        "flips": lambda one: percent(one["errors"]["flips"]),
        "axis": lambda one: number(one["errors"]["heading_mod_180_deg"]["mean"], 1),
        "length": lambda one: signed(one["errors"]["length_m"]["bias"], 2),
        "width": lambda one: signed(one["errors"]["width_m"]["bias"], 2),
        "ECE": lambda one: share(one["calibration"]["ece"]),
    }
    return _source_table("errors of right boxes (metres, degrees)", sources, columns)


def _images_table(images: Tree) -> Table:
    overlap = _overlap(images, "ap_2d_r40_")
    table = ColumnsTable("2D boxes of all classes", "camera", "truth", "recall", "precision", f"AP 2D {overlap}")
    for camera, classes in images.items():
        figures = classes[ALL]
        shares = (figures["recall"], figures["precision"], figures[f"ap_2d_r40_{overlap}"])
        table.add_row(camera, str(figures["truth"]), *map(share, shares))
    return table


def _tracking_table(tracking: Tree) -> Table:
    columns: Columns = {
        "HOTA": lambda one: share(one["hota"]),
        "DetA": lambda one: share(one["det_a"]),
        "AssA": lambda one: share(one["ass_a"]),
        "MOTA": lambda one: share(one["mota"]),
        "IDF1": lambda one: share(one["idf1"]),
        "switches": lambda one: str(one["id_switches"]),
        "fragments": lambda one: str(one["fragmentations"]),
        "flips": lambda one: str(one["heading_flips"]),
    }
    return _source_table("tracks", tracking, columns, count="truth_tracks")


def _motion_table(sources: Tree, tracking: Tree) -> Table:
    """What tracks say beyond places: velocity, covariance, and how many are of nothing."""
    by_source = {
        source: {name: {**sources[source][name], **one} for name, one in classes.items()}
        for source, classes in tracking.items()
    }
    columns: Columns = {
        "speed": lambda one: number(one["errors"]["velocity_m_s"]["rmse"], 2),
        "yaw/s": lambda one: number(one["errors"]["yaw_rate_deg_s"]["rmse"], 1),
        "flips": lambda one: percent(one["errors"]["flips_moving"]),
        "NEES": lambda one: number(one["errors"]["nees"]["mean"], 1),
        "in 95 %": lambda one: percent(one["errors"]["nees"]["inside_95"]),
        "pred.": lambda one: percent(one["predicted"]["nees"]["inside_95"]),
        "false": lambda one: str(one["false_tracks"]),
        "lasting": lambda one: number(one["false_track_s_mean"], 1),
    }
    return _source_table("motion and trust of tracks (m/s, degrees/s)", by_source, columns, count="truth_tracks")


def _chains_table(unlabelled: Tree) -> Table:
    columns = ("objects/frame", "chains", "seconds", "missing", "flickers", "relabelled", "flips")
    table = ColumnsTable("without truth: chains of one object", "source", *columns)
    for source, figures in unlabelled.items():
        chains = figures["chains"]
        table.add_row(
            source,
            number(figures["objects"].get("per_frame_mean"), 1),
            str(chains["chains"]),
            number(chains["seconds_mean"], 1),
            percent(chains["missing_share"]),
            *(str(chains[key]) for key in ("flickers", "class_changes", "heading_flips")),
        )
    return table


def _requirements_table(outcomes: Sequence[Outcome]) -> Table:
    table = ColumnsTable("required", "figure", "expected", "found", "", text_columns=("",))
    for outcome in outcomes:
        asked = outcome.requirement
        found = NONE if outcome.found is None else f"{outcome.found:.4g}"
        table.add_row(asked.name, f"{asked.sign} {asked.limit:g}", found, "not met" if outcome.failure else "met")
    return table


def _detection_explained(sources: Tree) -> Iterator[str]:
    """Meanings of the names above columns, and the rule by which a box is right."""
    by_distance = _by_distance(sources)
    at = "as nuScenes has it." if by_distance == "nuscenes" else "at four that go with the length of the class:"
    yield (
        "boxes: of the source. false: wrong boxes a frame. AP bev, AP 3D: average precision from above and in 3D at an "
        f"IoU of {_overlap(sources)} %, 40 recalls. mAP: the mean of those by distance of the centres, {at}"
    )
    for name, classes in _distances(sources, by_distance).items():
        yield f"  {name}: {classes}"
    yield (
        "A box is right if its centre, seen from above, is nearer than the third of these distances to that of a true "
        "object of its class that has no box yet. recall: true objects with a right box. prec.: boxes that are right."
    )


def _gain_explained(gains: Tree) -> Iterator[str]:
    yield "over: the better single sensor. + is better, also of the position."
    one, blocks = gains[ALL], gains[ALL]["blocks"]
    if one[_gain_name(one)]["low"] is None:
        yield f"There is no interval: a recording of {blocks} s is too short to draw samples from."
    elif blocks < MIN_BLOCKS:
        yield f"The interval is too narrow: a recording of {blocks} s is short to draw samples from."


def _distances(sources: Tree, by_distance: str) -> dict[str, str]:
    """The distances by class."""
    found = {}
    for name, figures in next(iter(sources.values())).items():
        if name != ALL and (thresholds := figures[by_distance].get("thresholds")):
            found[name] = ", ".join(f"{threshold['distance_m']:.3g}" for threshold in thresholds) + " m"
    return found


def _source_table(title: str, sources: Tree, columns: Columns, count: str = "truth") -> Table:
    """A row for each class and source, of classes that the truth or a source has; the class is named once."""
    table = ColumnsTable(title, "class", "source", *columns, text_columns=("source",))
    names = next(iter(sources.values()))
    by_class = {name: {source: classes[name] for source, classes in sources.items()} for name in names}
    shown = {
        name: figures
        for name, figures in by_class.items()
        if any(one[count] or one.get("found") for one in figures.values())
    }
    if len(shown) == 2:  # the figures of the only class are those of all
        shown.pop(ALL, None)
    for name, figures in shown.items():
        for row, (source, one) in enumerate(figures.items()):
            table.add_row("" if row else name, source, *(cell(one) for cell in columns.values()))
    return table


def _gain_name(gains: Tree, beginning: str = "ap_bev_r40_") -> str:
    return next(name for name in gains if name.startswith(beginning))


def _overlap(sources: Tree, beginning: str = "ap_bev_r40_") -> str:
    """The IoU that is shown, in percent: 50 if that is among them, else the last, as in the gain by fusion."""
    figures = next(iter(sources.values()))[ALL]
    known = [key.removeprefix(beginning) for key in figures if key.startswith(beginning)]
    return "50" if "50" in known else known[-1]


def _by_distance(sources: Tree) -> str:
    return "nuscenes" if "nuscenes" in next(iter(sources.values()))[ALL] else "distance"
