"""The outputs of a run: checked before it begins, opened together, and named together when all of them are whole."""

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from importlib.metadata import version
from itertools import chain
from pathlib import Path

from lidcam.outputs.account import account_text
from lidcam.outputs.allowed import TEXT, Replaceable, check_no_input, check_replaced
from lidcam.outputs.kinds import MATCHES, OUTPUTS, OutputKind, live_views
from lidcam.pipeline.core.errors import OutputError
from lidcam.readers.input_file import InputFiles
from lidcam.readers.rig.rig_file import rig_yaml
from lidcam.run.effect import lasting_settings
from lidcam.run.frames import RunInput
from lidcam.run.job import Job
from lidcam.run.summary import RunSummary
from lidcam.writers.base import ResultWriter
from lidcam.writers.outputs.transaction import OutputTransaction
from lidcam.writers.provenance import Provenance


def open_outputs(job: Job) -> OutputTransaction:
    """The outputs of a job, to be locked before the recording is opened.

    Raises:
        OutputError: one is of no known kind or of the same as another, or is an input.
    """
    known: dict[str, Path] = {}
    for output in job.outputs:
        if output.suffix not in OUTPUTS:
            endings = " or ".join(key for key in OUTPUTS if key.startswith("."))
            raise OutputError(f"{output}: expected a name that ends in {endings}, or without ending for a folder")
        if other := known.get(output.suffix):
            raise OutputError(f"{output}: expected one output of a kind, found {other}, too; choose one of them")
        known[output.suffix] = output
    for output in job.outputs:
        if OUTPUTS[output.suffix].of_result and ".mcap" not in known:
            raise OutputError(f"{output}: is made of the result: expected an .mcap among the outputs, found none")
    files = written_files(job)
    check_no_input(files, (*job.inputs, *job.read_files))
    folders = [path for path, kind in _kinds(job) if kind.folder_of]
    check_old = check_replaced(partial(_replaceable, job), overwrite=job.overwrite)
    return OutputTransaction(files, folders=folders, check_old=check_old)


def written_files(job: Job) -> tuple[Path, ...]:
    """The outputs, and the texts that are written beside them."""
    kinds = _kinds(job)
    beside = (kind.beside(path, job.config) for path, kind in kinds)
    return (*(path for path, _ in kinds), *chain.from_iterable(beside))


def how_to_open(job: Job) -> dict[str, str]:
    """Instructions to open the outputs, by the name of the viewer."""
    return {kind.viewer: kind.how_to_open(path, kind.beside(path, job.config)) for path, kind in _kinds(job)}


def _kinds(job: Job) -> list[tuple[Path, OutputKind]]:
    named = [(path, OUTPUTS[path.suffix]) for path in job.outputs]
    return named if job.save_matches is None else [*named, (job.save_matches, OUTPUTS[MATCHES])]


def _replaceable(job: Job, path: Path) -> Replaceable:
    kind = next((kind for output, kind in _kinds(job) if output == path), None)
    if kind is None:
        return TEXT
    if kind.folder_of:
        holds_more = f"exists and holds more than the {kind.folder_of} of an earlier run"
        return Replaceable(kind.is_result, holds_more, only_own=True)
    return Replaceable(
        kind.is_result,
        "exists and is no result of an earlier run (a recording? the output comes last)",
    )


def open_writers(
    job: Job,
    source: RunInput,
    inputs: InputFiles,
    outputs: OutputTransaction,
    stack: ExitStack,
    report: Callable[[], RunSummary],
) -> list[ResultWriter]:
    """The writers of a job's outputs and views, open; they end with `stack`, before the outputs get their names.

    Args:
        job: The outputs.
        source: The open recording.
        inputs: Its files.
        outputs: Where they are written.
        stack: Ends the writers.
        report: Gives the report of the run, at its end.

    Raises:
        OutputError: an output cannot be written.
    """
    provenance = _provenance(source, inputs, lambda: account_text(report(), job))
    kinds = ((path, kind.open) for path, kind in _kinds(job))
    files = (opened(path, outputs, source, provenance) for path, opened in kinds if opened)
    return [stack.enter_context(writer) for writer in chain(live_views(job, source, provenance), files)]


def make_pages(job: Job, outputs: OutputTransaction) -> None:
    """Write what is made of the finished result, before the outputs get their names.

    Raises:
        LidcamError: it cannot be made or written.
    """
    for path in job.outputs:
        module, _, name = OUTPUTS[path.suffix].of_result.partition(":")
        if name:
            (result,) = (one for one in job.outputs if one.suffix == ".mcap")
            outputs[path].write_text(getattr(import_module(module), name)(outputs[result].part))


def _provenance(source: RunInput, inputs: InputFiles, account: Callable[[], str]) -> Provenance:
    named = {f"{key}.name": file.name for key, file in inputs.named.items()}
    if "network" in inputs.named:
        named["network.provider"] = source.config.detect2d.provider
    return Provenance(
        version=version("lidcam"),
        inputs=tuple(file.provenance for file in inputs.unread),
        fingerprint=inputs.fingerprint,
        checksums=partial(_checksums, inputs),
        settings=str(source.settings),
        config_yaml=lasting_settings(source.config),
        rig_yaml=rig_yaml(source.rig),
        start_ns=source.recording.start_ns,
        boxes3d_topics=tuple(detector.topic for detector in source.rig.detectors),
        named=named,
        account=account,
    )


def _checksums(inputs: InputFiles) -> dict[str, str]:
    files = {f"input.{row}": file for row, file in enumerate(inputs.finish())} | dict(inputs.named)
    return {f"{key}.{fact}": value for key, file in files.items() for fact, value in file.as_read.items()}
