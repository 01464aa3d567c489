"""The commands on a result: `lidcam report`, `lidcam export` and `lidcam view`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from lidcam.cli.options import Overwrite, Truth, option, output_option, with_log_options
from lidcam.cli.printing.log import remark_log
from lidcam.cli.verdict import Verdict
from lidcam.outputs.registry import DatasetFormat, output_of
from lidcam.pipeline.core.errors import OutputError

REPORT_EXAMPLES = """\b
Examples:
  lidcam report out.mcap
  lidcam report out.mcap --out drive.html
"""


@with_log_options
def report(
    result: Annotated[Path, typer.Argument(metavar="RESULT.mcap", help="What `lidcam process` wrote.")],
    out: Annotated[Path | None, output_option("The page. Default: beside the result.", ".html")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a page about a result.

    One file that opens in any browser, offline. `lidcam process --report OUT.html` writes the same.
    """
    from lidcam.cli.printing.progress import show_progress
    from lidcam.outputs.report.make import write_page

    page = out or result.with_suffix(".html")
    incomplete = write_page(result, page, overwrite=overwrite, show=show_progress)
    remark_log.info("wrote %s", page)
    Verdict((), incomplete).end()


EXPORT_EXAMPLES = """\b
Examples:
  lidcam export out.mcap --format kitti --out dataset
  lidcam export out.mcap --format nuscenes --only confirmed --out set
  lidcam export out.mcap --format yolo --every 10 --out images
"""


@with_log_options
def export(
    results: Annotated[list[Path], typer.Argument(metavar="RESULT.mcap...", help="What `lidcam process` wrote.")],
    format_name: Annotated[DatasetFormat, option("Layout of the data set.", "--format")],
    out: Annotated[Path, option("Output folder; must be empty or not exist.", "--out", "-o", metavar="DIR")],
    only: Annotated[Literal["confirmed"] | None, option("Only objects that a camera confirms.")] = None,
    every: Annotated[int, option("Every Nth frame only.", metavar="N", min=1)] = 1,
    camera: Annotated[
        str,
        option(
            "The camera of KITTI's image_2 (default: the first with images), or the only one of coco and yolo.",
            metavar="NAME",
            show_default=False,
        ),
    ] = "",
    truth: Truth = None,
) -> None:
    """Write results as a data set: clouds, images, calibration, boxes.

    kitti, nuscenes and cvat have 3D boxes, coco and yolo 2D boxes in the images as recorded. Labels are the ground
    truth if there is any, else lidcam's objects, with the camera's 2D box or a projected one. All formats but yolo and
    cvat also contain these objects as scored detections.
    """
    from lidcam.cli.printing.progress import show_progress
    from lidcam.outputs.export.export import export_results
    from lidcam.outputs.export.frames import ExportOptions
    from lidcam.run.job import locations

    given = tuple(locations(truth or ()))
    options = ExportOptions(confirmed=only is not None, every=every, camera=camera, truth=given)
    done = export_results(results, out, format_name, options, show_progress)
    for line in done.remarks:
        remark_log.info("%s", line)
    kind = "ground-truth boxes" if done.of_truth else "boxes"
    remark_log.info("wrote %s: %d frames, %d images, %d %s", out, done.frames, done.images, done.boxes, kind)
    Verdict((), done.incomplete).end()


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
    from lidcam.outputs.allowed import is_own_mcap

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
        rest = "too, but without the objects; use --rerun OUT.rrd for those" if is_own_mcap(result) else "too"
        show_line(console(), f"Rerun opens it, {rest}.")
    else:
        raise OutputError(
            f"{result}: expected a result of lidcam, which ends in .rrd, .html, .mp4 or .mcap; to process a recording: "
            f"lidcam {result}"
        )
