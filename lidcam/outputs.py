"""The files that a run writes: refused before it begins where they cannot be, opened together when it does."""

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from hashlib import file_digest
from importlib.metadata import version
from pathlib import Path

from lidcam.frames import Source
from lidcam.job import Job
from pipeline.core.errors import OutputError
from pipeline.core.settings.load import dump_config
from pipeline.core.settings.run import RunConfig
from readers.location import Location, RemotePath
from readers.messages.image import decode_any_image
from readers.rig.rig_file import rig_yaml
from writers.base import ResultWriter
from writers.mcap.writer import McapResultWriter
from writers.provenance import Provenance

__all__ = ["check_not_overwritten", "check_outputs", "check_writable", "open_writers"]


def check_outputs(job: Job) -> None:
    """Look at the outputs before the recording is opened.

    Raises:
        OutputError: one cannot be written, is the recording itself, or both are one file.
    """
    for output in job.outputs:
        check_writable(output)
        check_not_overwritten(job.inputs, output)
    if len({output.resolve() for output in job.outputs}) < len(job.outputs):
        raise OutputError(f"{job.rerun}: is the same file as {job.output}; choose another name")


def check_writable(output: Path) -> None:
    """Whether a file of this name can be made.

    Raises:
        OutputError: it is a folder, or its folder does not exist.
    """
    if output.is_dir():
        raise OutputError(f"{output}: expected the name of a file to write, found a folder")
    if not output.parent.is_dir():
        raise OutputError(f"{output}: the folder {output.parent} does not exist; create it first")


def check_not_overwritten(inputs: Sequence[Location], *outputs: Path | None) -> None:
    """Whether an output is a file of the recording: by its name, inside its folder, or through a link.

    Raises:
        OutputError: it is.
    """
    files = [path for path in inputs if isinstance(path, Path) and path.exists()]
    for output in outputs:
        if output is not None and output.exists() and any(path.samefile(output) for path in files):
            raise OutputError(f"{output}: is a file of the recording itself; choose another name")


def open_writers(job: Job, source: Source, stack: ExitStack) -> list[ResultWriter]:
    """The writers of a job's outputs, open; they end with `stack`.

    Raises:
        OutputError: an output cannot be written.
    """
    if not job.outputs:
        return []
    provenance = _provenance(source)
    writers: list[ResultWriter] = []
    if job.output is not None:
        writers.append(stack.enter_context(McapResultWriter(job.output, source.rig, source.config, provenance)))
    if job.rerun is not None:
        from writers.rerun.writer import RerunResultWriter  # loads a viewer's worth of code

        decode = partial(decode_any_image, limits=source.config.limits)
        rerun = RerunResultWriter(job.rerun, source.rig, source.config, provenance, decode_any_image=decode)
        writers.append(stack.enter_context(rerun))
    return writers


def _provenance(source: Source) -> Provenance:
    config = source.config.model_copy(update={"run": RunConfig()})  # how it is run does not change the result
    return Provenance(
        version=version("lidcam"),
        inputs=tuple(_identity(path) for path in source.recording.paths),
        config_yaml=dump_config(config),
        rig_yaml=rig_yaml(source.rig),
        start_ns=source.recording.start_ns,
    )


def _identity(path: Location) -> dict[str, str]:
    """What tells an input file from others; a file on a server is not fetched as a whole for its checksum."""
    if isinstance(path, RemotePath):
        return {"name": path.name, "url": str(path), **dict(path.facts)}
    with path.open("rb") as file:
        return {"name": path.name, "sha256": file_digest(file, "sha256").hexdigest()}
