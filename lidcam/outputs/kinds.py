"""The kinds of outputs of a run, one row each, and the views of it while it goes on."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from lidcam.outputs.allowed import (
    is_marked_clouds,
    is_marked_csv,
    is_marked_film,
    is_marked_mcap,
    is_marked_page,
    is_marked_parquet,
    is_marked_pictures,
    is_marked_rrd,
)
from lidcam.pipeline.core.errors import ConfigError, OutputError, RecordingError
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.image import decode_any_image
from lidcam.run.box_sources import box_source
from lidcam.run.frames import RunInput
from lidcam.run.job import Job
from lidcam.writers.base import ResultWriter
from lidcam.writers.clouds.writer import ObjectCloudsWriter
from lidcam.writers.foxglove.layout import layout_path
from lidcam.writers.live.pace import Pace
from lidcam.writers.mcap.writer import McapResultWriter
from lidcam.writers.outputs.marks import RESULT
from lidcam.writers.outputs.transaction import OutputFile, OutputTransaction
from lidcam.writers.pictures.matches import MatchesWriter
from lidcam.writers.pictures.scene import Scenes
from lidcam.writers.provenance import Provenance
from lidcam.writers.rerun.environment import without_rerun_variables
from lidcam.writers.tables.writer import CsvObjectsWriter, ParquetObjectsWriter

MATCHES = "save_matches"
"""The option of a job that names the folder of pictures."""


@dataclass(frozen=True, slots=True)
class OutputKind:
    """A kind of output, known from the ending of its name.

    Attributes:
        open: Makes the writer; None of what is made of the finished result.
        is_result: Whether a run of lidcam wrote the file that stands at a path, so that a later run may replace it;
            raises OSError where that cannot be read.
        viewer: Name of the viewer that opens it, for the last lines of a run.
        how_to_open: Gives the instruction to open it, from the paths of the output and of the texts beside it.
        beside: The texts that the writer writes beside it, by its path and the settings.
        folder_of: What it holds, where it is a folder.
        of_result: The function that makes its text of the finished result, as `module:name`, where it has no writer.
    """

    open: Callable[[Path, OutputTransaction, RunInput, Provenance], ResultWriter] | None
    is_result: Callable[[Path], bool]
    viewer: str
    how_to_open: Callable[[Path, tuple[Path, ...]], str]
    beside: Callable[[Path, Config], tuple[Path, ...]] = lambda _path, _config: ()
    folder_of: str = ""
    of_result: str = ""


def _mcap(path: Path, outputs: OutputTransaction, source: RunInput, provenance: Provenance) -> ResultWriter:
    layout = outputs.get(layout_path(path))
    return McapResultWriter(outputs[path], source.rig, source.config, provenance, layout, frames=source.truth_frames)


def _layout(path: Path, config: Config) -> tuple[Path, ...]:
    return (layout_path(path),) if config.output.layout else ()


def _open_mcap(_: Path, beside: tuple[Path, ...]) -> str:
    layouts = "".join(f", then Layouts, Import from file, {layout.name}" for layout in beside)
    return f"open the .mcap{layouts} (Lichtblick, too)"


def _rrd(path: Path, outputs: OutputTransaction, source: RunInput, provenance: Provenance) -> ResultWriter:
    return _rerun(outputs[path], source, provenance)


def _rerun(output: OutputFile | None, source: RunInput, provenance: Provenance) -> ResultWriter:
    with without_rerun_variables():
        from lidcam.writers.rerun.writer import RerunResultWriter  # loads Rerun, which takes half a second

    decode = partial(decode_any_image, limits=source.config.limits)
    return RerunResultWriter(output, source.rig, source.config, provenance, decode_any_image=decode)


def drawn_scenes(source: RunInput) -> Scenes:
    """What gathers, over the frames of a run, what their pictures show."""
    return Scenes(source.rig, source.config, partial(decode_any_image, limits=source.config.limits))


def _film(path: Path, outputs: OutputTransaction, source: RunInput, provenance: Provenance) -> ResultWriter:
    try:
        from lidcam.writers.pictures.film import FilmWriter
    except ModuleNotFoundError as err:
        raise OutputError(f"{path}: a film needs PyAV: pip install 'lidcam[video]'") from err
    _check_images(path, source)
    return FilmWriter(outputs[path], drawn_scenes(source), provenance)


def _matches(path: Path, outputs: OutputTransaction, source: RunInput, provenance: Provenance) -> ResultWriter:
    if not source.rig.cameras:
        raise RecordingError(f"{path}: pictures of matches need cameras: no camera of the recording is used")
    _check_images(path, source)
    return MatchesWriter(outputs[path], drawn_scenes(source), provenance)


def _check_images(path: Path, source: RunInput) -> None:
    if source.rig.cameras and not source.config.output.images and box_source(source.config, source.rig) != "onnx":
        raise ConfigError(f"{path}: images are not read: expected output.images=true, found false")


def _csv(path: Path, outputs: OutputTransaction, source: RunInput, _: Provenance) -> ResultWriter:
    return CsvObjectsWriter(outputs[path], source.rig, source.config.object_names)


def _parquet(path: Path, outputs: OutputTransaction, source: RunInput, provenance: Provenance) -> ResultWriter:
    return ParquetObjectsWriter(outputs[path], source.rig, source.config.object_names, provenance)


def _clouds(path: Path, outputs: OutputTransaction, source: RunInput, _: Provenance) -> ResultWriter:
    if source.config.track.mode == "none":
        raise ConfigError(f"{path}: clouds of objects need tracks: expected track.mode offline or online, found none")
    return ObjectCloudsWriter(outputs[path], source.config.object_names, source.config.output)


OUTPUTS: dict[str, OutputKind] = {
    ".mcap": OutputKind(_mcap, partial(is_marked_mcap, mark=RESULT), "Foxglove", _open_mcap, _layout),
    ".rrd": OutputKind(_rrd, is_marked_rrd, "Rerun", lambda path, _: f"rerun {path}"),
    ".csv": OutputKind(_csv, is_marked_csv, "CSV", lambda path, _: f"open {path} in a spreadsheet, or pandas.read_csv"),
    ".parquet": OutputKind(
        _parquet,
        is_marked_parquet,
        "Parquet",
        lambda path, _: f"open {path} with pandas.read_parquet, polars or DuckDB",
    ),
    "": OutputKind(
        _clouds,
        is_marked_clouds,
        "Clouds",
        lambda path, _: f"open the .pcd in {path} with CloudCompare, or open3d.t.io.read_point_cloud",
        folder_of="clouds",
    ),
    ".mp4": OutputKind(_film, is_marked_film, "Film", lambda path, _: f"open {path} in a browser or a player"),
    MATCHES: OutputKind(
        _matches,
        is_marked_pictures,
        "Pictures",
        lambda path, _: f"look at the .jpg in {path}",
        folder_of="pictures",
    ),
    ".html": OutputKind(
        None,
        is_marked_page,
        "Report",
        lambda path, _: f"open {path} in a browser",
        of_result="lidcam.outputs.report.make:make_page",
    ),
}
"""By the ending of their names; a folder of clouds has none, and that of pictures has an option of its own."""


def live_views(job: Job, source: RunInput, provenance: Provenance) -> Iterator[ResultWriter]:
    """What shows the frames of a job while it goes on; first what holds it back for those who watch.

    Raises:
        OutputError: a library is not installed.
    """
    if job.pace is not None:
        yield Pace(job.pace)
    if job.view:
        yield _rerun(None, source, provenance)
    if job.foxglove is not None:
        if find_spec("foxglove") is None:
            raise OutputError("--foxglove needs foxglove-sdk, which is not installed: pip install 'lidcam[foxglove]'")
        from lidcam.writers.live.server import FoxgloveServer  # an extra

        title = ", ".join(known["name"] for known in provenance.inputs) or "lidcam"
        yield FoxgloveServer(*job.foxglove, title, source.rig, source.config, frames=source.truth_frames)
