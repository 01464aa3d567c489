"""Writes results as one data set."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from lidcam.evaluation.evaluate import Progress, not_shown
from lidcam.outputs.allowed import Replaceable, check_no_input, check_replaced
from lidcam.outputs.export.scene import ExportOptions, ResultScene
from lidcam.outputs.registry import DATASETS, DatasetFormat, loaded
from lidcam.pipeline.core.errors import OutputError
from lidcam.readers.results.result import open_result
from lidcam.run.missing import damage_lines
from lidcam.writers.datasets.frame import DatasetWriter
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.transaction import OutputFile, OutputTransaction

DEFAULT = ExportOptions()

EMPTY = Replaceable(lambda path: not any(path.iterdir()), "exists and is not empty", only_own=True)
"""What may stand where a data set is written."""


@dataclass(frozen=True, slots=True)
class Exported:
    """What was exported."""

    frames: int  # Number of frames that were read
    objects: int  # Number of objects in them that the format can have
    true_objects: int | None  # The same of the truth; None without truth
    remarks: tuple[str, ...]  # What the user should know, a line each: what was left out, and why
    incomplete: tuple[str, ...]  # Damaged parts of the results


def export_results(
    results: Sequence[Path],
    folder: Path,
    format_name: DatasetFormat,
    options: ExportOptions = DEFAULT,
    show: Progress = not_shown,
) -> Exported:
    """Write results as one data set.

    Args:
        results: Files that `lidcam process` wrote, one scene each, with different names.
        folder: The new folder, which is empty or does not exist.
        format_name: One of `DATASETS`.
        options: What to write of them.
        show: Shows the progress.

    Raises:
        LidcamError: a result cannot be read or has not what the format needs; the folder cannot be written.
    """
    if format_name not in DATASETS:
        raise OutputError(f"format: expected {', '.join(DATASETS)}, found {format_name!r}")
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
        writer: DatasetWriter = loaded(DATASETS[format_name])(output.part, options.camera)
    remarks, incomplete, frames, objects, true_objects = list[str](), list[str](), 0, 0, list[int]()
    for path in results:
        with ExitStack() as stack:
            result = stack.enter_context(open_result(path))
            advance = stack.enter_context(show((result.recording.end_ns - result.recording.start_ns) / 1e9))
            scene = ResultScene(result, format_name, writer, options, stack)
            with output_errors(output.path):
                writer.begin(scene.facts)
            for frame in scene.frames():
                with output_errors(output.path):
                    writer.add_frame(frame)
                frames, objects = frames + 1, objects + len(frame.objects)
                true_objects += [] if frame.truth is None else [len(frame.truth)]
                advance((frame.stamp_ns - result.recording.start_ns) / 1e9, f"{frames} frames exported")
            remarks += scene.notes
            incomplete += damage_lines(result.recording.losses)
    with output_errors(output.path):
        writer.finish()
    left_out = [f"left out: {count} {reason}" for reason, count in writer.left_out.items()]
    return Exported(
        frames,
        objects,
        sum(true_objects) if true_objects else None,
        (*remarks, *writer.remarks, *left_out),
        tuple(incomplete),
    )
