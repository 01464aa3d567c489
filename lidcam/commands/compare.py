"""The work of `lidcam compare`."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from lidcam.checks.incomplete import damage_lines
from lidcam.commands.envelope import envelope
from lidcam.commands.json_output import json_output
from lidcam.commands.verdict import Verdict
from lidcam.outputs.allowed import MERGED, TEXT, check_no_input, check_replaced
from lidcam.outputs.merged import write_both
from lidcam.printing.comparison import print_comparison
from lidcam.printing.folding import show_line
from lidcam.printing.log import remark_log
from lidcam.printing.progress import show_progress
from lidcam.printing.terminal import console
from pipeline.core.errors import LidcamError
from pipeline.core.settings.compare import CompareConfig
from pipeline.core.settings.config import Config
from pipeline.evaluation.comparison.comparison import Comparison
from pipeline.evaluation.comparison.differences import Channel
from pipeline.evaluation.comparison.frames import FramePair, paired_frames
from pipeline.evaluation.comparison.object_changes import KINDS, Kind
from readers.input_file import read_input_file
from readers.results.result import Result, open_result
from writers.foxglove.layout import layout_path
from writers.outputs.transaction import OutputTransaction

__all__ = ["FRAMES", "CompareOptions", "run_compare"]

FRAMES = "frames"
"""Allowed beside the kinds of differences: frames that one result alone has."""


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """Arguments of a comparison.

    Attributes:
        first: The result A.
        second: The result B.
        config: Settings, of which `compare` counts.
        settings_name: Where they come from.
        only: Sources and cameras that are compared; all if it is empty.
        allowed: Kinds of differences that may be, and `frames`.
        max_different_percent: Share of the objects of a source or camera, and of the frames, that may differ otherwise.
        lines: Differences that are printed.
        merged: MCAP to write, with both results in it.
        as_json: Print JSON in place of the tables.
        json_file: Where the JSON is written; None: nowhere.
        overwrite: Replace what no earlier run wrote, too.
        read_files: Files that were read for the settings.
    """

    first: Path
    second: Path
    config: Config
    settings_name: str = "defaults"
    only: tuple[str, ...] = ()
    allowed: tuple[str, ...] = ()
    max_different_percent: float = 0.0
    lines: int = 10
    merged: Path | None = None
    as_json: bool = False
    json_file: Path | None = None
    overwrite: bool = False
    read_files: tuple[Path, ...] = ()


def run_compare(options: CompareOptions) -> None:
    """Compare two results and print what differs.

    Raises:
        CheckError: more differs than may.
        IncompleteError: it does not, but a result is damaged.
        LidcamError: a result cannot be read, or the two cannot be compared.
    """
    inputs = options.first, options.second, *options.read_files
    written = () if options.merged is None else (options.merged, layout_path(options.merged))
    check_no_input(written, inputs)
    check_old = check_replaced(lambda path: MERGED if path == options.merged else TEXT, overwrite=options.overwrite)
    with (
        json_output(
            options.json_file, is_printed=options.as_json, inputs=(*inputs, *written), overwrite=options.overwrite
        ) as json,
        OutputTransaction(written, check_old=check_old) as outputs,
    ):
        with open_result(options.first) as first, open_result(options.second) as second, ExitStack() as stack:
            _check_frames(first, second)
            comparison = _comparison(first, second, options)
            pairs = _pairs(first, second, options.config.compare, stack)
            if options.merged is None:
                for pair in pairs:
                    comparison.add(pair)
            else:
                write_both(outputs, options.merged, (first, second), comparison, pairs)
            comparison.close()
            losses = *first.recording.losses, *second.recording.losses
            verdict = Verdict(_failures(comparison, options), damage_lines(losses))
            notes = [*_recordings_note(first, second), *first.notes, *second.notes]
        figures = comparison.figures()
        json.tree = _tree(figures, verdict, notes, options)
    for path in written:
        remark_log.info("wrote %s", path)
    out = console()
    json.show(out, lambda: _print(out, figures, verdict, notes, options))
    verdict.end()


def _check_frames(first: Result, second: Result) -> None:
    frames = first.rig.site_frame, second.rig.site_frame
    if frames[0] != frames[1]:
        raise LidcamError(
            f"{second.path}: expected objects in the frame of {first.path}, {frames[0]!r}, found {frames[1]!r}; "
            "compare results of one site"
        )


def _recordings_note(first: Result, second: Result) -> Iterator[str]:
    """That they may differ in everything; what one of them does not say of its recording does not count."""
    names, checksums, sizes = (
        [
            [value for key, value in sorted(result.metadata.items()) if key.startswith("input.") and key.endswith(fact)]
            for result in (first, second)
        ]
        for fact in (".name", ".sha256", ".size")
    )
    facts = [checksums] if all(checksums) else [names, sizes]
    if any(a and b and a != b for a, b in facts):
        yield f"A and B are results of different recordings: {', '.join(names[0])}, {', '.join(names[1])}"


def _comparison(first: Result, second: Result, options: CompareOptions) -> Comparison:
    channels: list[Channel] = [("sources", name) for name in dict.fromkeys((*first.sources, *second.sources))]
    channels += [("images", name) for name in dict.fromkeys((*first.cameras, *second.cameras))]
    known = [name for _, name in channels]
    if unknown := [name for name in options.only if name not in known]:
        raise LidcamError(f"--only {unknown[0]}: expected one of {', '.join(known)}, which the results have")
    chosen = [channel for channel in channels if not options.only or channel[1] in options.only]
    return Comparison(first.config.classes, second.config.classes, options.config.compare, chosen, _kinds(options))


def _kinds(options: CompareOptions) -> list[Kind]:
    return [kind for kind in KINDS if kind in options.allowed]


def _pairs(first: Result, second: Result, config: CompareConfig, stack: ExitStack) -> Iterator[FramePair]:
    """The frames of both, with progress."""
    start_ns = min(first.recording.start_ns, second.recording.start_ns)
    end_ns = max(first.recording.end_ns, second.recording.end_ns)
    advance = stack.enter_context(show_progress((end_ns - start_ns) / 1e9))
    pairs = paired_frames(first.frames(), second.frames(), max_apart_ns=round(config.stamp_s * 1e9))
    for number, pair in enumerate(pairs):
        yield pair
        log_time_ns = max(frame.log_time_ns for frame in (pair.first, pair.second) if frame is not None)
        advance((log_time_ns - start_ns) / 1e9, f"{number + 1} frames")


def _failures(comparison: Comparison, options: CompareOptions) -> tuple[str, ...]:
    """Lines about each source or camera that differs more than it may."""
    found = comparison.not_allowed_percent(frames_may_differ=FRAMES in options.allowed)
    but = f" but for what is {', '.join(kinds)}" if (kinds := _kinds(options)) else ""
    return tuple(
        f"{name}: expected at most {options.max_different_percent:g} % "
        + ("in one result alone" if name == FRAMES else f"of the objects to differ{but}")
        + f", found {percent:.3g} %"
        for name, percent in found.items()
        if percent > options.max_different_percent
    )


def _tree(
    figures: Mapping[str, Any], verdict: Verdict, notes: Sequence[str], options: CompareOptions
) -> dict[str, Any]:
    tolerances = options.config.compare.model_dump(mode="json")
    settings = {
        "name": options.settings_name,
        "sha256": sha256(yaml.safe_dump(tolerances).encode()).hexdigest(),
        "compare": tolerances,
        "only": [*options.only],
        "allowed": [*options.allowed],
        "max_different_percent": options.max_different_percent,
    }
    inputs = [read_input_file(path) for path in (options.first, options.second)]
    return envelope("compare", inputs=inputs, settings=settings, figures=figures, verdict=verdict, notes=notes)


def _print(
    out: Console, figures: Mapping[str, Any], verdict: Verdict, notes: Sequence[str], options: CompareOptions
) -> None:
    names = [str(path) for path in (options.first, options.second)]
    print_comparison(out, figures, names, options.config.compare, lines=options.lines)
    for note in notes:
        show_line(out, f"note: {note}")
    show_line(out, f"verdict: {'differs more than it may' if verdict.failures else _equal(figures)}")


def _equal(figures: Mapping[str, Any]) -> str:
    is_equal = not any((figures["differences"]["count"], figures["frames_only_in_a"], figures["frames_only_in_b"]))
    return "equal within the tolerances" if is_equal else "differs no more than it may"
