"""The outputs of a run: checked before it begins, opened together, and named together when all of them are whole."""

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from itertools import chain
from pathlib import Path

from lidcam.outputs.allowed import TEXT, Replaceable, check_no_input, check_replaced
from lidcam.outputs.registry import OUTPUTS, Output, loaded, output_of, shown_outputs, written_outputs
from lidcam.outputs.writers import Opening
from lidcam.pipeline.core.errors import OutputError
from lidcam.run.frames import RunInput
from lidcam.run.job import Job
from lidcam.writers.base import ResultWriter
from lidcam.writers.outputs.transaction import OutputTransaction
from lidcam.writers.provenance import Provenance


def open_outputs(job: Job) -> OutputTransaction:
    """The outputs of a job, to be locked before the recording is opened.

    Raises:
        OutputError: one is of no known kind or of the same as another, or is an input.
    """
    known: dict[str, Path] = {}
    for path in job.outputs:
        if output_of(path) is None:
            endings = " or ".join(output.ending for output in OUTPUTS if output.ending)
            raise OutputError(f"{path}: expected a name that ends in {endings}, or without ending for a folder")
        if other := known.get(path.suffix):
            raise OutputError(f"{path}: expected one output of a kind, found {other}, too; choose one of them")
        known[path.suffix] = path
    for path, output in written_outputs(job):
        if output.made_of_result and ".mcap" not in known:
            raise OutputError(f"{path}: needs an .mcap output as well: it is made of that result")
        for module in output.needs:
            import_module(module)  # says what is missing before the run, not after it
    files = written_files(job)
    check_no_input(files, (*job.inputs, *job.read_files))
    folders = [path for path, output in written_outputs(job) if output.folder_of]
    allowed = {path: _replaceable(output) for path, output in written_outputs(job)}
    check_old = check_replaced(lambda path: allowed.get(path, TEXT), overwrite=job.overwrite)
    return OutputTransaction(files, folders=folders, check_old=check_old)


def _replaceable(output: Output) -> Replaceable:
    is_own = loaded(output.is_own)
    if output.folder_of:
        return Replaceable(is_own, f"exists and holds more than the {output.folder_of} of an earlier run", True)
    return Replaceable(is_own, "exists and was not written by lidcam (the output comes last, or behind -o)")


def written_files(job: Job) -> tuple[Path, ...]:
    """The outputs, and the texts that are written beside them."""
    outputs = written_outputs(job)
    beside = (output.beside(path, job.config) for path, output in outputs)
    return (*(path for path, _ in outputs), *chain.from_iterable(beside))


def how_to_open(job: Job) -> dict[str, str]:
    """Instructions to open the outputs, by the name of the viewer."""
    outputs = written_outputs(job)
    return {output.name: output.instruction(path, output.beside(path, job.config)) for path, output in outputs}


def open_writers(
    job: Job, source: RunInput, provenance: Provenance, outputs: OutputTransaction, views: ExitStack, files: ExitStack
) -> Sequence[ResultWriter]:
    """The writers of a job, open: views end with `views`, when the outputs have their names, the others with `files`.

    Raises:
        OutputError: an output cannot be written, or a library is not installed.
    """
    opening = partial(Opening, job, source, provenance, outputs)
    shown = [(views, Path(output.option), output) for output in shown_outputs(job)]
    written = [(files, path, output) for path, output in written_outputs(job) if not output.made_of_result]
    return [stack.enter_context(loaded(one.open)(opening(path=path))) for stack, path, one in (*shown, *written)]


def make_pages(job: Job, outputs: OutputTransaction) -> None:
    """Write what is made of the finished result, before the outputs get their names."""
    for path, output in written_outputs(job):
        if output.made_of_result:
            (result,) = (one for one in job.outputs if one.suffix == ".mcap")
            film = result.with_suffix(".mp4")
            name = film.name if film in job.outputs and path.parent == result.parent else ""
            html, _ = loaded(output.made_of_result)(outputs[result].part, film=name)
            outputs[path].write_text(html)
