"""The command `lidcam compare`."""

from hashlib import sha256
from pathlib import Path
from typing import Annotated

import typer

from lidcam.cli.options import AsJson, JsonFile, Overwrite, option, with_log_options
from lidcam.cli.verdict import Verdict
from lidcam.evaluation.allowed import AllowedDifference

COMPARE_EXAMPLES = """\
Exit codes: 0 no more differences than allowed; 1 more, or the results cannot
be compared; 2 wrong usage; 3 as 0, but a file is damaged.

\b
Examples:
  lidcam compare golden.mcap new.mcap
  lidcam compare golden.mcap new.mcap --only fused --max-different 1
  lidcam compare golden.mcap new.mcap --allow rescored
"""


@with_log_options
def compare(
    first: Annotated[Path, typer.Argument(metavar="A.mcap", help="What `lidcam process` wrote.")],
    second: Annotated[Path, typer.Argument(metavar="B.mcap", help="Another result of the same recording or scene.")],
    only: Annotated[
        list[str] | None,
        option("Source (fused, lidar, cameras) or camera to compare; default: all. May be repeated.", metavar="NAME"),
    ] = None,
    allow: Annotated[
        list[AllowedDifference] | None,
        option(
            "Kind of difference to allow, by any amount: lost, new, moved, turned, resized, relabelled, rescored, "
            "reidentified (objects) or frames (of one result alone). May be repeated.",
            metavar="KIND",
        ),
    ] = None,
    max_different: Annotated[
        float,
        option(
            "Share of objects (per source or camera) and of frames allowed to differ.",
            metavar="PERCENT",
            min=0,
            max=100,
        ),
    ] = 0.0,
    lines: Annotated[int, option("Number of differences to print.", metavar="N", min=0)] = 10,
    as_json: AsJson = False,
    json_file: JsonFile = None,
    overwrite: Overwrite = False,
) -> None:
    """Show what differs between two results, object by object.

    Objects that are lost, new, moved, turned, resized, relabelled, rescored, or have another id; B against A.
    """
    from lidcam.cli.json_output import figures_document, json_output
    from lidcam.cli.printing.comparison import print_comparison
    from lidcam.cli.printing.progress import show_progress
    from lidcam.cli.printing.terminal import console, show_json, show_line
    from lidcam.evaluation.compare import compare_results
    from lidcam.pipeline.evaluation.comparison.object_changes import TOLERANCES

    with json_output(json_file, inputs=(first, second), overwrite=overwrite) as write_json:
        found = compare_results(
            first, second, only=only or (), allow=allow or (), max_different_percent=max_different, show=show_progress
        )
        verdict = Verdict(found.failures, found.incomplete)
        tree = figures_document(
            "compare",
            inputs=found.inputs,
            settings={
                "name": "tolerances",
                "sha256": sha256(repr(TOLERANCES).encode()).hexdigest(),
                "compare": TOLERANCES,
                "only": only or [],
                "allowed": [*(allow or ())],
                "max_different_percent": max_different,
            },
            figures=found.figures.tree,
            verdict=verdict,
            notes=found.notes,
        )
        write_json(tree)
    out = console()
    if as_json:
        show_json(out, tree)
    else:
        print_comparison(out, found.figures.tree, [str(first), str(second)], lines=lines)
        for note in found.notes:
            show_line(out, f"note: {note}")
        within = "equal within the tolerances" if found.is_equal else "no more differences than allowed"
        show_line(out, f"verdict: {'more differences than allowed' if verdict.failures else within}")
    verdict.end()
