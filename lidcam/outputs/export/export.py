"""Writes results as one data set."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidcam.evaluation.evaluate import Progress, not_shown
from lidcam.outputs.allowed import Replaceable, check_no_input, check_replaced
from lidcam.outputs.export.frames import ExportOptions
from lidcam.outputs.export.images import ResultImages
from lidcam.outputs.export.scene import ResultScene
from lidcam.outputs.registry import DATASETS, DatasetFormat, loaded
from lidcam.pipeline.core.errors import OutputError
from lidcam.readers.results.result import open_result
from lidcam.run.missing import damage_lines
from lidcam.writers.datasets.images import ImageWriter
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.transaction import OutputFile, OutputTransaction

OF_ONE_CAMERA: tuple[DatasetFormat, ...] = ("kitti", "kitti-tracking", "coco", "yolo")
"""Formats that have one camera, or the images of one if that is asked for."""

EMPTY = Replaceable(lambda path: not any(path.iterdir()), "exists and is not empty", only_own=True)
"""The folder of a data set may exist if it is empty."""


@dataclass(frozen=True, slots=True)
class Exported:
    """Counts of an export."""

    frames: int  # Number of frames in the data set
    images: int  # Number of images in it
    boxes: int  # Number of boxes in its labels
    of_truth: bool  # Whether all of these are true ones
    remarks: tuple[str, ...]  # What the user should know, a line each: what was left out, and why
    incomplete: tuple[str, ...]  # Damaged parts of the results


def export_results(
    results: Sequence[Path],
    folder: Path,
    format_name: DatasetFormat,
    options: ExportOptions,
    show: Progress = not_shown,
) -> Exported:
    """Write results, one scene each, as one data set, in a folder that is empty or does not exist.

    Raises:
        LidcamError: a result cannot be read or has not what the format needs; the folder cannot be written.
    """
    if format_name not in DATASETS:
        raise OutputError(f"format: expected {', '.join(DATASETS)}, found {format_name!r}")
    if not results:
        raise OutputError("expected results to export, found none")
    if options.camera and format_name not in OF_ONE_CAMERA:
        raise OutputError(f"camera: {format_name} has all cameras; only {', '.join(OF_ONE_CAMERA)} take one")
    check_no_input([folder], [*results, *options.truth])
    check_old = check_replaced(lambda _: EMPTY, overwrite=False)
    with OutputTransaction([folder], folders=[folder], check_old=check_old) as outputs:
        return _export(results, outputs[folder], format_name, options, show)


def _export(
    results: Sequence[Path], output: OutputFile, format_name: DatasetFormat, options: ExportOptions, show: Progress
) -> Exported:
    names = [path.stem for path in results]
    if same := next((name for name in names if names.count(name) > 1), None):
        raise OutputError(f"expected results of different names, found two called {same}")
    with output_errors(output.path):
        output.part.mkdir()
        writer: Any = loaded(DATASETS[format_name])(output.part, options.camera)
    remarks, incomplete, without_truth = list[str](), list[str](), list[str]()
    for path in results:
        with ExitStack() as stack:
            result = stack.enter_context(open_result(path))
            start_ns = result.recording.start_ns
            advance = stack.enter_context(show((result.recording.end_ns - start_ns) / 1e9))
            scene = (
                ResultImages(result, writer, options, stack)
                if isinstance(writer, ImageWriter)
                else ResultScene(result, format_name, writer, options, stack)
            )
            with output_errors(output.path):
                writer.begin(scene.facts)
            for frame in scene.frames():
                with output_errors(output.path):
                    writer.add_frame(frame)
                advance((frame.stamp_ns - start_ns) / 1e9, f"{writer.written['frames']} frames exported")
            without_truth += [] if scene.has_truth else [path.name]
            remarks += scene.notes
            incomplete += damage_lines(result.recording.losses)
    with output_errors(output.path):
        writer.finish()
    if 0 < len(without_truth) < len(results):
        remarks.append(f"labels without ground truth are what lidcam found: {', '.join(without_truth)}")
    left_out = [f"left out: {count} {reason}" for reason, count in writer.left_out.items()]
    return Exported(
        frames=writer.written["frames"],
        images=writer.written["images"],
        boxes=writer.written["boxes"],
        of_truth=not without_truth,
        remarks=(*remarks, *writer.remarks, *left_out),
        incomplete=tuple(incomplete),
    )
