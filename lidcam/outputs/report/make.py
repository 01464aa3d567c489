"""Makes the page about a result: one pass over its frames, a few of its clouds, the images of its worst errors."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rich.table import Table

from lidcam.cli.printing.evaluation import headlines, mistake_note, own_tables, truth_tables
from lidcam.cli.printing.terminal import Folded
from lidcam.evaluation.evaluate import Progress, evaluate_result, not_shown, within_labels
from lidcam.evaluation.evaluation import Evaluation, EvaluationJob
from lidcam.outputs.allowed import PAGE, check_no_input, check_replaced, is_own_film
from lidcam.outputs.report import sections
from lidcam.outputs.report.images import CLOUD_TOPIC, busiest_images, mistake_image
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.settings.load import dump_config
from lidcam.pipeline.evaluation.detection.plots import DetectionPlots
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.results.result import Result, open_result
from lidcam.readers.truth.site import SitePoses
from lidcam.run.warning import RunWarning
from lidcam.writers.outputs.transaction import OutputTransaction
from lidcam.writers.report import accuracy, plots
from lidcam.writers.report.collector import ReportCollector
from lidcam.writers.report.grid import FIRST_CELL_M, MAX_CELLS, MAX_CLOUDS, SparseGrid
from lidcam.writers.report.page import PageTable, page
from lidcam.writers.report.site_map import map_figure
from lidcam.writers.report.values import Figure

SHOWN_FACTS = "network.", "labels.", "boxes3d.", "detector"
"""Beginnings of the names of metadata that the page lists."""

KINDS = {"false": "Worst false detections", "missed": "Worst missed objects"}


def write_page(
    result: Path, page_path: Path, *, overwrite: bool = False, show: Progress = not_shown
) -> tuple[str, ...]:
    """Write the page about a result; returns the parts of it that could not be used.

    Raises:
        LidcamError: the result cannot be read, or the page cannot be written or replace what stands there.
    """
    check_no_input([page_path], [result])
    check_old = check_replaced(lambda _: PAGE, overwrite=overwrite)
    with OutputTransaction([page_path], check_old=check_old) as outputs:
        html, incomplete = make_page(result, show, film=film_of(result, page_path))
        outputs[page_path].write_text(html)
    return incomplete


def make_page(path: Path, show: Progress = not_shown, *, film: str = "") -> tuple[str, tuple[str, ...]]:
    """The page about a result, as HTML, and the parts of it that could not be used; the same result, the same bytes.

    `film` is the name of the run's film in the folder of the page; empty without one.
    """
    job = within_labels(EvaluationJob(path))
    with open_result(path, job.settings) as result:
        names, summary, metadata = result.config.class_names, result.summary, result.metadata
        seen = ReportCollector(result.config, result.rig, is_adrift=result.is_adrift)
        measured = DetectionPlots(result.config)
        evaluation = evaluate_result(job, show, (seen, measured))
        tree: Mapping[str, Any] = evaluation.figures.tree
        background = background_of(result, () if result.is_adrift else seen.log_times_ns)
        warnings = [*(RunWarning(**one) for one in summary.get("warnings", ())), *evaluation.warnings]
        against = [f"Against the recorded ground truth, {line}" for line in headlines(tree)[:1]]
        if evaluation.truth is None:
            against = ["No ground truth was recorded, so accuracy cannot be measured."]
        truth_note = _truth_note(evaluation)
        html = page(
            _figures(result, seen, measured, background),
            title=f"{metadata.get('input.0.name', path.name)}: what lidcam saw",
            result_name=path.name,
            version=metadata.get("version", "unknown"),
            seen=seen,
            lead=sections.lead(seen, names),
            busiest=busiest_images(result, seen.busiest) if seen.busiest is not None else (),
            busiest_note=sections.busiest_note(seen),
            film=quote(film),
            rate=sections.frame_rate(seen),
            counts=sections.counts(seen, names),
            has_summary=bool(summary),
            doubts=sections.doubts(seen, summary, warnings),
            against="".join(against),
            map_notes=" ".join(_map_notes(result, seen, background)),
            has_zones=len(seen.users.table.places) > 1,
            movements=sections.movements(seen.users.table, names),
            truth_note=truth_note,
            headlines=headlines(tree) if truth_note else (),
            worst=_worst(result, seen, tree) if truth_note else (),
            truth_tables=_page_tables(truth_tables(tree)) if truth_note else (),
            residual_tables=_page_tables(own_tables(tree)),
            dropped_tables=sections.dropped(summary),
            origin_tables=[*sections.origin(seen, result), _versions(result)],
            checksums=sections.checksums(metadata, path.name, evaluation.inputs[0].tree()["sha256"] or ""),
            origin_notes=evaluation.notes,
            settings=dump_config(result.config),
        )
        return html, evaluation.incomplete


def film_of(result: Path, page: Path) -> str:
    """Name of the film of a result, where both and its page are in one folder; empty where there is none."""
    film = result.with_suffix(".mp4")
    return film.name if page.resolve().parent == result.resolve().parent and is_own_film(film) else ""


def background_of(result: Result, log_times_ns: Sequence[int]) -> SparseGrid:
    """Where points lie, of some of these frames, in the frame that does not move; no cells if it has no clouds."""
    grid, poses = SparseGrid(FIRST_CELL_M, MAX_CELLS), SitePoses([result.recording], result.rig, result.config)
    step = max(len(log_times_ns) // MAX_CLOUDS, 1)
    for log_time_ns in log_times_ns[step // 2 :: step]:
        for message in result.recording.messages([CLOUD_TOPIC], start_ns=log_time_ns, stop_ns=log_time_ns + 1):
            T_fixed_site = poses.T_fixed_site(message.stamp_ns)
            try:
                cloud = decode_pointcloud2(message, limits=result.config.limits)
            except MessageError:
                continue
            if T_fixed_site is not None:
                grid.add_points(T_fixed_site.apply(cloud.xyz)[:, :2].astype(float))
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
    if users.moved.any():
        found["speeds"] = plots.speeds_figure(users, names)
    if len(users):
        found["dwell"] = plots.dwell_figure(users, names)
    if any(seen.log_times_ns):
        found["sensors"] = plots.sensors_figure(seen, rig)
        found["skew"] = plots.skew_figure(seen)
    if measured.truth_counts:
        curves, errors = accuracy.curves_figure(measured, names), accuracy.error_map(measured)
        found |= {"curves": curves} if curves["data"] else {}
        found |= {} if errors is None else {"errors": errors}
    return found


def _map_notes(result: Result, seen: ReportCollector, background: SparseGrid) -> Iterable[str]:
    yield "View from above; a dot marks the last position of a track." if seen.is_tracked else "View from above."
    if len(background):
        cell_cm = background.cell_m * 100
        yield f"Grey: lidar points of up to {MAX_CLOUDS} clouds, in cells of {cell_cm:.3g} cm."
    elif result.is_adrift:
        yield "The sensors moved, but the result does not hold their path: tracks are drawn relative to the sensors."
    else:
        yield "The result has no clouds (output.clouds), so there is no background."
    if seen.travelled_m:
        yield f"The sensors travelled {seen.travelled_m:.0f} m; the map is fixed to the ground."
    if seen.poses_known < seen.frames:
        yield f"{seen.frames - seen.poses_known} frames without a recorded pose are not drawn."
    if seen.courses.tolerance_m > 0.1:
        yield f"Tracks are simplified to a point every {seen.courses.tolerance_m:.2g} m."
    if seen.courses.left_out:
        yield f"Too many tracks: the {seen.courses.left_out} shortest are not drawn."


def _truth_note(evaluation: Evaluation) -> str:
    """How much truth there is; empty without any."""
    tree: Mapping[str, Any] = evaluation.figures.tree
    if evaluation.truth is None or not tree["frames_with_truth"]:
        return ""
    return (
        f"{tree['frames_with_truth']} of {tree['frames']} frames have truth, from {evaluation.truth}; "
        f"{tree['truth_objects']['evaluated']} true objects count."
    )


def _worst(
    result: Result, seen: ReportCollector, tree: Mapping[str, Any]
) -> Iterable[tuple[str, list[tuple[str, str]]]]:
    """The worst errors: title, and images with captions."""
    for kind, title in KINDS.items():
        tiles = []
        for mistake in tree["mistakes"]["fused"][kind]:
            shown = mistake_image(result, kind, mistake, seen.log_times_ns[mistake["worst_frame"]])
            if shown is not None:
                frames = f"{mistake['frames']} frame{'s' * (mistake['frames'] != 1)}"
                words = f"{mistake['class']} at {mistake['worst_s']:.1f} s, {frames}, {shown[1]}; "
                tiles.append((shown[0], words + mistake_note(kind, mistake)))
        if tiles:
            yield title, tiles


def _page_tables(tables: Iterable[tuple[Table, Iterable[str]]]) -> list[PageTable]:
    """Tables of the console, with the lines that explain them."""
    found = []
    for table, notes in tables:
        columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
        words = [row for row, column in enumerate(table.columns) if column.justify == "left"]
        head = [_plain(column.header) for column in table.columns]
        found.append(PageTable(head, list(zip(*columns, strict=True)), words, str(table.title), list(notes)))
    return found


def _plain(cell: object) -> str:
    return cell.text if isinstance(cell, Folded) else str(cell)


def _versions(result: Result) -> PageTable:
    metadata = result.metadata
    named = {key: text for key, text in metadata.items() if key.startswith(SHOWN_FACTS)}
    facts = [
        ["lidcam", metadata.get("version", "unknown")],
        ["settings", metadata.get("settings", "unknown")],
        *([key, text] for key, text in named.items() if not key.endswith(".sha256")),
        ["site frame", result.rig.site_frame],
    ]
    return PageTable(["", ""], [[key, sections.code(text)] for key, text in facts], (0, 1))
