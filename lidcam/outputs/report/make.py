"""Makes the page about a result: one pass over its frames, a few of its clouds, the images of its worst errors."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table

from lidcam.cli.printing.evaluation import headlines, own_tables, truth_tables
from lidcam.cli.printing.folding import Folded
from lidcam.cli.printing.mistakes import mistake_note
from lidcam.evaluation.evaluate import Progress, evaluate_result, not_shown
from lidcam.evaluation.evaluation import Evaluation, EvaluationJob
from lidcam.outputs.report import sections
from lidcam.outputs.report.pictures import CLOUD_TOPIC, mistake_image
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.settings.load import dump_config
from lidcam.pipeline.evaluation.detection.plots import DetectionPlots
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.results.result import Result, open_result
from lidcam.readers.truth.site import SitePoses
from lidcam.run.warning import RunWarning
from lidcam.writers.report import accuracy, html, plots
from lidcam.writers.report.collector import ReportCollector
from lidcam.writers.report.grid import SparseGrid
from lidcam.writers.report.html import Raw
from lidcam.writers.report.page import page
from lidcam.writers.report.site_map import map_figure
from lidcam.writers.report.values import Figure

CLOUDS = 48
"""Clouds of the background, evenly over the recording."""

FIRST_CELL_M = 0.02
MAX_CELLS = 150_000
"""Of the background."""

KINDS = {"false": "Reported, and not there", "missed": "There, and not reported"}


def make_page(path: Path, show: Progress = not_shown) -> str:
    """The page about a result, as HTML; the same result gives the same bytes.

    Args:
        path: The .mcap that `lidcam process` wrote.
        show: Shows the progress.

    Raises:
        LidcamError: the result cannot be read.
    """
    with open_result(path) as result:
        seen = ReportCollector(result.config, result.rig, is_adrift=result.is_adrift)
        measured = DetectionPlots(result.config)
        evaluation = evaluate_result(EvaluationJob(path), show, (seen, measured))
        background = SparseGrid(FIRST_CELL_M, MAX_CELLS) if result.is_adrift else _background(result, seen)
        drawn = _figures(result, seen, measured, background)
        title = f"{result.metadata.get('input.0.name', path.name)}: what lidcam saw"
        return page(title, _body(title, result, seen, evaluation, drawn, background), drawn)


def _background(result: Result, seen: ReportCollector) -> SparseGrid:
    """Where points lie, in the frame that does not move; without cells where the result has no clouds."""
    grid, poses = SparseGrid(FIRST_CELL_M, MAX_CELLS), SitePoses([result.recording], result.rig, result.config)
    step = max(len(seen.log_times_ns) // CLOUDS, 1)
    for log_time_ns in seen.log_times_ns[step // 2 :: step]:
        for message in result.recording.messages([CLOUD_TOPIC], start_ns=log_time_ns, stop_ns=log_time_ns + 1):
            T_fixed_site = poses.T_fixed_site(message.stamp_ns)
            try:
                cloud = decode_pointcloud2(message, limits=result.config.limits)
            except MessageError:
                continue
            if T_fixed_site is not None:
                grid.add(T_fixed_site.apply(cloud.xyz)[:, :2].astype(float))
    return grid


def _figures(
    result: Result, seen: ReportCollector, measured: DetectionPlots, background: SparseGrid
) -> dict[str, Figure]:
    """The plots that there is something for, by the name of their place."""
    rig, names = result.rig, result.config.class_names
    users = seen.users.table
    if seen.frames > 1 and seen.seconds:
        seen.time.at_least(1.5 * seen.seconds / (seen.frames - 1))
        used = min((seen.sensors.sums(topic).sum() for topic in rig.sensor_of_topic), default=0.0)
        seen.sensors.at_least(min(3 * seen.seconds / max(used, 1.0), seen.seconds / 12))
    found: dict[str, Figure] = {}
    if any(seen.objects.values()) or len(background):
        found["map"] = map_figure(seen, rig, background, names)
    if any(seen.objects.values()):
        found["objects"] = plots.objects_figure(seen, names, rig.place_names)
    if len(users):
        found["speeds"] = plots.speeds_figure(users, names)
        found["dwell"] = plots.dwell_figure(users, names)
    if any(seen.log_times_ns):
        found["sensors"] = plots.sensors_figure(seen, rig)
        found["skew"] = plots.skew_figure(seen)
    if measured.sources:
        curves, errors = accuracy.curves_figure(measured, names), accuracy.error_map(measured)
        found |= {"curves": curves} if curves["data"] else {}
        found |= {} if errors is None else {"errors": errors}
    return found


def _body(
    title: str,
    result: Result,
    seen: ReportCollector,
    evaluation: Evaluation,
    drawn: Mapping[str, Figure],
    background: SparseGrid,
) -> Raw:
    summary, names, metadata = result.summary, result.config.class_names, result.metadata
    version = metadata.get("version", "unknown")
    warnings = [*(RunWarning(**one) for one in summary.get("warnings", ())), *evaluation.warnings]
    has_truth = evaluation.truth is not None
    parts = {
        "map": ("Where they went", _map(result, seen, drawn, background)),
        "time": ("When", _time(drawn, seen)),
        "moves": ("How fast, how long, and where to", _moves(seen, drawn, names)),
        "accuracy": ("How right it is", _accuracy(result, seen, evaluation, drawn)),
        "residuals": ("How well sensors agree", _own(evaluation.figures.tree)),
        "dropped": ("Not used, and why", sections.dropped(summary)),
        "origin": ("What was recorded and used", _origin(result, seen, evaluation)),
    }
    written = {name: part for name, part in parts.items() if part[1]}
    links = "".join(f'<a href="#{name}-section">{html.text(text)}</a>' for name, (text, _) in written.items())
    against = [f"Against the recorded truth, {line}" for line in headlines(evaluation.figures.tree)[:1]]
    if not has_truth:
        against = ["No truth was recorded: how right the result is, nobody can tell from it alone."]
    return Raw(
        f"<h1>{html.text(title)}</h1>"
        + sections.verdict(result.path.name, seen, names)
        + sections.doubts(seen, summary, warnings, version)
        + "".join(map(html.paragraph, against))
        + f"<nav>{links}</nav>"
        + "".join(html.section(f"{name}-section", text, content) for name, (text, content) in written.items())
        + f"<footer>Made by lidcam {html.text(version)} from {html.text(result.path.name)}. Plots: plotly.js (MIT "
        "licence). Nothing is loaded from elsewhere when this page is opened.</footer>"
    )


def _map(result: Result, seen: ReportCollector, drawn: Mapping[str, Figure], background: SparseGrid) -> Raw:
    if "map" not in drawn:
        return Raw()
    notes = ["Seen from above; a dot is where a track was last." if seen.is_tracked else "Seen from above."]
    if len(background):
        cell_cm = background.cell_m * 100
        notes.append(f"Grey: points of the lidars in up to {CLOUDS} clouds, in cells of {cell_cm:.3g} cm.")
    elif result.is_adrift:
        notes.append("The sensors moved, and where to is not in the result: ways are as seen from the sensors.")
    else:
        notes.append("The result has no clouds (output.clouds), so there is no background.")
    if seen.travelled_m:
        notes.append(f"The sensors moved by {seen.travelled_m:.0f} m; the map stands still, where that is recorded.")
    if seen.poses_known < seen.frames:
        notes.append(
            f"In {seen.frames - seen.poses_known} frames it is not recorded where the sensors were: not drawn."
        )
    if seen.courses.tolerance_m > 0.1:
        notes.append(f"Ways are simplified: corners are {seen.courses.tolerance_m:.2g} m apart.")
    if seen.courses.left_out:
        notes.append(f"The {seen.courses.left_out} shortest tracks are not drawn, because there are too many.")
    return html.figure("map", "", " ".join(notes))


def _time(drawn: Mapping[str, Figure], seen: ReportCollector) -> Raw:
    parts = (
        [html.figure("objects", "Objects at a time", f"Means over {seen.time.step_s:g} s.")]
        if "objects" in drawn
        else []
    )
    if "sensors" in drawn:
        parts.append(
            html.figure(
                "sensors",
                "Sensors",
                f"Rate at which frames have each sensor, in steps of {seen.sensors.step_s:g} s: blue as mostly, orange "
                "less, red not at all; blank where there is no frame.",
            )
        )
        parts.append(
            html.figure(
                "skew",
                "Skew",
                "Largest less smallest stamp of the messages of a frame: how far apart in time sensors looked.",
            )
        )
    return Raw("".join(parts))


def _moves(seen: ReportCollector, drawn: Mapping[str, Figure], names: tuple[str, ...]) -> Raw:
    if "speeds" not in drawn:
        return Raw()
    users = seen.users.table
    pair = html.figure("speeds", "Speeds", "Mean speed of each road user over the ground.") + html.figure(
        "dwell", "Time in zones" if len(users.places) > 1 else "Time in view", "Shortest, quarters, longest."
    )
    ways = sections.movements(users, names)
    if not ways and len(users.places) > 1:
        ways = html.paragraph("Nobody went from one zone to another.", "soft")
    return Raw(f'<div class="pair">{pair}</div>' + (f"<h3>From zone to zone</h3>{ways}" if ways else ""))


def _accuracy(result: Result, seen: ReportCollector, evaluation: Evaluation, drawn: Mapping[str, Figure]) -> Raw:
    tree: Mapping[str, Any] = evaluation.figures.tree
    truth = evaluation.truth
    if truth is None or not tree["frames_with_truth"]:
        return Raw()
    told = f"{tree['frames_with_truth']} of {tree['frames']} frames have truth, from {' and '.join(truth.sources)}; "
    told += f"{tree['truth_objects']['evaluated']} true objects count."
    words_of = {
        "curves": ("Precision over recall", "Each point is a threshold of the score; up and right is better."),
        "errors": ("Errors by place", "In the site frame, which moves with sensors that move."),
    }
    pair = "".join(html.figure(name, *words) for name, words in words_of.items() if name in drawn)
    tables = "".join(_table(table, lines) for table, lines in truth_tables(tree))
    return Raw(
        "".join(html.paragraph(line, "lead") for line in headlines(tree))
        + html.paragraph(told, "soft")
        + f'<div class="pair">{pair}</div>'
        + _worst(result, seen, tree)
        + html.more("All figures of the evaluation", Raw(tables))
    )


def _worst(result: Result, seen: ReportCollector, tree: Mapping[str, Any]) -> Raw:
    """The worst errors as images."""
    parts = []
    for kind, title in KINDS.items():
        tiles = []
        for mistake in tree["mistakes"]["fused"][kind]:
            shown = mistake_image(result, kind, mistake, seen.log_times_ns[mistake["worst_frame"]])
            if shown is not None:
                words = f"{mistake['class']} at {mistake['worst_s']:.1f} s, {_frames(mistake['frames'])}, {shown[1]}; "
                tiles.append(html.image(shown[0], words + mistake_note(kind, mistake)))
        if tiles:
            parts.append(f'<h3>{title}: the worst</h3><div class="tiles">{"".join(tiles)}</div>')
    return Raw("".join(parts))


def _frames(count: int) -> str:
    return f"{count} frame{'s' * (count != 1)}"


def _own(tree: Mapping[str, Any]) -> Raw:
    return Raw("".join(_table(table, lines) for table, lines in own_tables(tree)))


def _table(table: Table, lines: Any) -> Raw:
    """A table of the console as HTML, with the lines that explain it."""
    columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
    words = [row for row, column in enumerate(table.columns) if column.justify == "left"]
    head = [_plain(column.header) for column in table.columns]
    shown = html.table(head, zip(*columns, strict=True), words)
    return Raw(f"<h3>{html.text(table.title)}</h3>{shown}" + "".join(html.paragraph(line, "soft") for line in lines))


def _plain(cell: object) -> str:
    return cell.text if isinstance(cell, Folded) else str(cell)


def _origin(result: Result, seen: ReportCollector, evaluation: Evaluation) -> Raw:
    metadata = result.metadata
    (file,) = evaluation.inputs
    facts = [
        ["lidcam", metadata.get("version", "unknown")],
        ["settings", metadata.get("settings", "unknown")],
        *([key, metadata[key]] for key in ("config.sha256", "rig.sha256") if key in metadata),
        *([key, text] for key, text in metadata.items() if key.startswith(("network.", "labels.", "boxes3d."))),
        ["site frame", result.rig.site_frame],
        [f"{result.path.name}, sha256", file.tree()["sha256"] or ""],
    ]
    notes = "".join(html.paragraph(note, "soft") for note in evaluation.notes)
    return Raw(
        sections.origin(seen, result.summary, metadata, result.rig.sensor_of_topic)
        + html.table(["", ""], [[key, Raw(f"<code>{html.text(text)}</code>")] for key, text in facts], (0, 1))
        + notes
        + html.more("All settings", Raw(f"<pre>{html.text_block(dump_config(result.config))}</pre>"))
    )
