"""The command `lidcam compare`."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidcam.cli.options import AsJson, JsonFile, Overwrite, Setting, with_log_options
from lidcam.cli.verdict import Verdict
from lidcam.pipeline.core.errors import LidcamError

if TYPE_CHECKING:
    from lidcam.pipeline.core.settings.evaluate import CompareConfig
    from lidcam.pipeline.evaluation.comparison.comparison import Comparison
    from lidcam.pipeline.evaluation.comparison.frames import FramePair
    from lidcam.readers.results.result import Result

# \b keeps the lines of a paragraph as they are.
COMPARE_EXAMPLES = """\b
Exit codes: 0 equal within the tolerances, or as far as is allowed; 1 they
differ more, or cannot be compared; 2 wrong usage; 3 equal, but a file is
damaged.

\b
Examples:
  lidcam compare golden.mcap new.mcap
  lidcam compare golden.mcap new.mcap --only fused --max-different 1
  lidcam compare golden.mcap new.mcap --set compare.yaw_deg=5 --allow rescored
"""


class AllowedDifference(StrEnum):
    """Kinds of differences between two results that may be allowed, and frames of one result alone."""

    LOST = "lost"
    NEW = "new"
    MOVED = "moved"
    TURNED = "turned"
    RESIZED = "resized"
    RELABELLED = "relabelled"
    RESCORED = "rescored"
    REIDENTIFIED = "reidentified"
    FRAMES = "frames"


@with_log_options
def compare(
    first: Annotated[Path, typer.Argument(metavar="A.mcap", help="A result of process.")],
    second: Annotated[Path, typer.Argument(metavar="B.mcap", help="Another one, of the same recording or scene.")],
    config_file: Annotated[
        str | None,
        typer.Option("--config", metavar="PRESET|FILE", help="Settings file; only its `compare` tolerances are used."),
    ] = None,
    settings: Setting = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="NAME",
            help="Source (fused, lidar, cameras) or camera to compare; default: all. May be repeated.",
        ),
    ] = None,
    allow: Annotated[
        list[AllowedDifference] | None,
        typer.Option(
            "--allow",
            metavar="KIND",
            help="Kind of difference to allow, by any amount: lost, new, moved, turned, resized, relabelled, rescored, "
            "reidentified (objects) or frames (of one result alone). May be repeated.",
        ),
    ] = None,
    max_different: Annotated[
        float,
        typer.Option(
            "--max-different",
            min=0,
            max=100,
            metavar="PERCENT",
            help="Share of objects (per source or camera) and of frames allowed to differ.",
        ),
    ] = 0.0,
    lines: Annotated[int, typer.Option("--lines", min=0, metavar="N", help="Number of differences to print.")] = 10,
    as_json: AsJson = False,
    json_file: JsonFile = None,
    overwrite: Overwrite = False,
) -> None:
    """Show what differs between two results, object by object.

    Objects that are lost, new, moved, turned, resized, relabelled, rescored, or go on under another id; B against A.
    """
    from lidcam.cli.json_output import figures_document, json_output
    from lidcam.cli.printing.comparison import print_comparison
    from lidcam.cli.printing.folding import show_line
    from lidcam.cli.printing.terminal import console, show_json
    from lidcam.pipeline.core.settings.load import load_config
    from lidcam.readers.input_file import read_opened_files
    from lidcam.readers.results.result import open_result
    from lidcam.run.effect import COMPARING, check_effect
    from lidcam.run.job import read_files
    from lidcam.run.missing import changed_lines, damage_lines

    check_effect(settings or (), COMPARING)
    config = load_config(config_file, settings or ()).compare
    inputs = first, second, *read_files(config_file, None)
    with json_output(json_file, inputs=inputs, overwrite=overwrite) as write_json:
        with open_result(first) as one, open_result(second) as other, ExitStack() as stack:
            comparison = _comparison(one, other, config, only or (), allow or ())
            for pair in _pairs(one, other, stack):
                comparison.add_pair(pair)
            comparison.close()
            losses = *one.recording.losses, *other.recording.losses
            notes = [*_recordings_note(one, other), *one.notes, *other.notes]
            files = read_opened_files((*one.recording.opened, *other.recording.opened))
        figures = comparison.figures()
        changed = changed_lines(file.path for file in files if file.is_changed)
        verdict = Verdict(_failures(comparison, allow or (), max_different), [*damage_lines(losses), *changed])
        tolerances = config.model_dump(mode="json")
        tree = figures_document(
            "compare",
            inputs=files,
            settings={
                "name": config_file or "defaults",
                "sha256": _sha256(tolerances),
                "compare": tolerances,
                "only": only or [],
                "allowed": [*(allow or ())],
                "max_different_percent": max_different,
            },
            figures=figures,
            verdict=verdict,
            notes=notes,
        )
        write_json(tree)
    out = console()
    if as_json:
        show_json(out, tree)
    else:
        print_comparison(out, figures, [str(first), str(second)], config, lines=lines)
        for note in notes:
            show_line(out, f"note: {note}")
        show_line(out, f"verdict: {'differs more than it may' if verdict.failures else _equal(figures)}")
    verdict.end()


def _comparison(
    first: "Result",
    second: "Result",
    config: "CompareConfig",
    only: Sequence[str],
    allowed: Sequence[AllowedDifference],
) -> "Comparison":
    """A comparison of the sources and cameras that are asked for.

    Raises:
        LidcamError: the results are of two sites, or have no source or camera of such a name.
    """
    from lidcam.pipeline.evaluation.comparison.comparison import Comparison
    from lidcam.pipeline.evaluation.comparison.differences import Channel
    from lidcam.pipeline.evaluation.comparison.object_changes import KINDS

    frames = first.rig.site_frame, second.rig.site_frame
    if frames[0] != frames[1]:
        raise LidcamError(
            f"{second.path}: expected objects in the frame of {first.path}, {frames[0]!r}, found {frames[1]!r}; "
            "compare results of one site"
        )
    channels: list[Channel] = [("sources", name) for name in dict.fromkeys((*first.sources, *second.sources))]
    channels += [("images", name) for name in dict.fromkeys((*first.cameras, *second.cameras))]
    known = [name for _, name in channels]
    if unknown := [name for name in only if name not in known]:
        raise LidcamError(f"--only {unknown[0]}: expected one of {', '.join(known)}, which the results have")
    chosen = [channel for channel in channels if not only or channel[1] in only]
    kinds = [kind for kind in KINDS if kind in allowed]
    return Comparison(first.config.classes, second.config.classes, config, chosen, kinds)


def _recordings_note(first: "Result", second: "Result") -> Iterator[str]:
    """A note if the results are of two recordings; only facts that both results hold of theirs are compared."""
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


def _pairs(first: "Result", second: "Result", stack: ExitStack) -> Iterator["FramePair"]:
    """The frames of both, with progress."""
    from lidcam.cli.printing.progress import show_progress
    from lidcam.pipeline.evaluation.comparison.frames import paired_frames

    start_ns = min(first.recording.start_ns, second.recording.start_ns)
    end_ns = max(first.recording.end_ns, second.recording.end_ns)
    advance = stack.enter_context(show_progress((end_ns - start_ns) / 1e9))
    pairs = paired_frames(first.frames(), second.frames())
    for number, pair in enumerate(pairs):
        yield pair
        log_time_ns = max(frame.log_time_ns for frame in (pair.first, pair.second) if frame is not None)
        advance((log_time_ns - start_ns) / 1e9, f"{number + 1} frames")


def _failures(
    comparison: "Comparison", allowed: Sequence[AllowedDifference], max_different_percent: float
) -> tuple[str, ...]:
    """Lines about each source or camera that differs more than it may."""
    frames = AllowedDifference.FRAMES
    found = comparison.not_allowed_percent(frames_may_differ=frames in allowed)
    kinds = [kind for kind in AllowedDifference if kind in allowed and kind != frames]
    but = f" but for what is {', '.join(kinds)}" if kinds else ""
    return tuple(
        f"{name}: expected at most {max_different_percent:g} % "
        + ("in one result alone" if name == frames else f"of the objects to differ{but}")
        + f", found {percent:.3g} %"
        for name, percent in found.items()
        if percent > max_different_percent
    )


def _sha256(tolerances: Mapping[str, Any]) -> str:
    import yaml

    return sha256(yaml.safe_dump(tolerances).encode()).hexdigest()


def _equal(figures: Mapping[str, Any]) -> str:
    is_equal = not any((figures["differences"]["count"], figures["frames_only_in_a"], figures["frames_only_in_b"]))
    return "equal within the tolerances" if is_equal else "differs no more than it may"
