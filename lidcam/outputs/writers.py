"""Opens the writers of a run's outputs; the rows of `OUTPUTS` name these functions."""

import logging
import time
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from lidcam.pipeline.core.errors import ConfigError, OutputError, RecordingError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop
from lidcam.readers.messages.image import decode_any_image
from lidcam.run.box_sources import detects_in_images
from lidcam.run.frames import RunInput
from lidcam.run.job import Job
from lidcam.writers.base import ResultWriter
from lidcam.writers.foxglove.layout import layout_path
from lidcam.writers.images.matches import MatchesWriter
from lidcam.writers.images.scene import Scenes
from lidcam.writers.mcap.writer import McapResultWriter
from lidcam.writers.outputs.transaction import OutputFile, OutputTransaction
from lidcam.writers.provenance import Provenance
from lidcam.writers.rerun.environment import without_rerun_variables
from lidcam.writers.tables.writer import CsvObjectsWriter, ParquetObjectsWriter


@dataclass(frozen=True, slots=True)
class Opening:
    """Parts of a writer."""

    job: Job  # The run
    source: RunInput  # The open recording, its rig and settings
    provenance: Provenance  # Where the result comes from
    outputs: OutputTransaction  # The locked outputs
    path: Path  # This output; of a view, its option

    @property
    def file(self) -> OutputFile:
        """The file or folder to write."""
        return self.outputs[self.path]


def open_mcap(opening: Opening) -> ResultWriter:
    """The result."""
    source, layout = opening.source, opening.outputs.get(layout_path(opening.path))
    return McapResultWriter(
        opening.file, source.rig, source.config, opening.provenance, layout, frames=source.truth_frames
    )


def open_rerun(opening: Opening) -> ResultWriter:
    """The Rerun recording, or the viewer, which is no output."""
    with without_rerun_variables():
        from lidcam.writers.rerun.writer import RerunResultWriter  # loads Rerun, which takes half a second
    source, output = opening.source, opening.outputs.get(opening.path)
    decode = partial(decode_any_image, limits=source.config.limits)
    return RerunResultWriter(output, source.rig, source.config, opening.provenance, decode_any_image=decode)


def drawn_scenes(source: RunInput) -> Scenes:
    """A collector of the content of images over the frames of a run."""
    return Scenes(source.rig, source.config, partial(decode_any_image, limits=source.config.limits))


def open_film(opening: Opening) -> ResultWriter:
    """The film."""
    try:
        from lidcam.writers.images.film import FilmWriter
    except ModuleNotFoundError as err:
        raise OutputError(f"{opening.path}: a film needs PyAV: pip install 'lidcam[video]'") from err
    _check_images(opening)
    return FilmWriter(opening.file, drawn_scenes(opening.source), opening.provenance)


def open_matches(opening: Opening) -> ResultWriter:
    """The images of each camera."""
    if not opening.source.rig.cameras:
        raise RecordingError(f"{opening.path}: images of matches need cameras: no camera of the recording is used")
    _check_images(opening)
    return MatchesWriter(opening.file, drawn_scenes(opening.source), opening.provenance)


def _check_images(opening: Opening) -> None:
    rig, config = opening.source.rig, opening.source.config
    if rig.cameras and not config.output.images and not detects_in_images(config, rig):
        raise ConfigError(f"{opening.path}: needs images: set output.images=true")


def open_csv(opening: Opening) -> ResultWriter:
    """The table of objects as CSV."""
    return CsvObjectsWriter(opening.file, opening.source.rig, opening.source.config.object_names)


def open_parquet(opening: Opening) -> ResultWriter:
    """The table of objects as Parquet."""
    names = opening.source.config.object_names
    return ParquetObjectsWriter(opening.file, opening.source.rig, names, opening.provenance)


def open_pace(opening: Opening) -> ResultWriter:
    """The writer that holds the run back for those who watch."""
    assert opening.job.pace is not None
    return Pace(opening.job.pace)


def open_foxglove(opening: Opening) -> ResultWriter:
    """The server of frames over Foxglove's protocol."""
    if find_spec("foxglove") is None:
        raise OutputError("foxglove needs foxglove-sdk, which is not installed: pip install 'lidcam[foxglove]'")
    from lidcam.writers.live.server import FoxgloveServer  # an extra

    assert opening.job.foxglove is not None
    title = ", ".join(known["name"] for known in opening.provenance.inputs) or "lidcam"
    source = opening.source
    server = FoxgloveServer(*opening.job.foxglove, title, source.rig, source.config, frames=source.truth_frames)
    logging.getLogger("lidcam.remarks").info("in Foxglove: Open connection, ws://%s:%d", *opening.job.foxglove)
    return server


class Pace(ResultWriter):
    """The first of the writers: it waits until a frame is due, `times` as fast as recorded, seen from the first one."""

    name = "pace"
    path = Path("--pace")

    def __init__(self, times: float) -> None:
        self._times = times
        self._first: tuple[float, int] | None = None

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Wait for the time of a frame."""
        now_s, stamp_ns = time.monotonic(), result.bundle.stamp_ns
        if self._first is None:
            self._first = now_s, stamp_ns
        started_s, first_ns = self._first
        time.sleep(max(started_s + (stamp_ns - first_ns) / 1e9 / self._times - now_s, 0.0))
        return ()
