"""The command `lidcam view`."""

from pathlib import Path
from typing import Annotated

import typer

from lidcam.cli.options import with_log_options
from lidcam.pipeline.core.errors import OutputError

VIEW_EXAMPLES = """\b
Examples:
  lidcam view out.rrd
  lidcam view out.html
  lidcam view out.mcap
"""


@with_log_options
def view(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Result: .rrd, .html, .mp4 or .mcap, or a folder of these.")
    ],
) -> None:
    """Open a result: a .rrd in Rerun, a page or a film in the browser.

    For an .mcap, prints how to open it in Foxglove.
    """
    import subprocess
    import webbrowser

    from lidcam.cli.printing.terminal import console, show_line
    from lidcam.outputs.registry import output_of

    if result.is_dir():  # of `lidcam drive.bag`
        found = [path for ending in ("*.rrd", "*.html", "*.mcap") for path in sorted(result.glob(ending))]
        result = found[0] if found else result
    if not result.is_file():
        raise OutputError(f"{result}: expected a result to open, found no such file")
    if result.suffix == ".rrd":
        from lidcam.writers.rerun.viewer import check_display, viewer_program  # loads Rerun

        check_display(str(result), f"`rerun --web-viewer {result}` shows it in a browser")
        command, environment = viewer_program(str(result))
        if code := subprocess.run(command, env=environment, check=False).returncode:
            raise OutputError(f"{result}: the Rerun viewer ended with {code}")
    elif result.suffix in {".html", ".mp4"}:
        if not webbrowser.open(result.resolve().as_uri()):
            raise OutputError(f"{result}: found no browser to open it with; copy this one file to a machine with one")
    elif result.suffix == ".mcap":
        output, layout = output_of(result), result.with_suffix(".foxglove.json")
        assert output is not None
        how = output.instruction(result, (layout,) if layout.is_file() else ())
        show_line(console(), f"{output.name}: {how}")
        show_line(console(), "Rerun opens it, too, but without the objects; use --rerun OUT.rrd for those.")
    else:
        raise OutputError(
            f"{result}: expected a result of lidcam, which ends in .rrd, .html, .mp4 or .mcap; to process a recording: "
            f"lidcam {result}"
        )
