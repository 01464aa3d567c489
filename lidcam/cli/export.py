"""The command `lidcam export`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from lidcam.cli.options import Truth, with_log_options
from lidcam.cli.printing.log import remark_log
from lidcam.cli.verdict import Verdict
from lidcam.outputs.registry import DatasetFormat

EXPORT_EXAMPLES = """\b
Examples:
  lidcam export out.mcap --format kitti --out dataset
  lidcam export out.mcap --format nuscenes --only confirmed --out set
  lidcam export out.mcap --format yolo --every 10 --out images
"""


@with_log_options
def export(
    results: Annotated[list[Path], typer.Argument(metavar="RESULT.mcap...", help="What `lidcam process` wrote.")],
    format_name: Annotated[DatasetFormat, typer.Option("--format", help="Layout of the data set.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Output folder; must be empty or not exist.")],
    only: Annotated[
        Literal["confirmed"] | None, typer.Option("--only", help="Only objects that a camera confirms.")
    ] = None,
    every: Annotated[int, typer.Option("--every", min=1, metavar="N", help="Every Nth frame only.")] = 1,
    camera: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="The camera of KITTI's image_2 (default: the first with images), or the only one of coco and yolo.",
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
