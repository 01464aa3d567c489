"""The names of `import lidcam`: the runs of the command line, with results to work on."""

from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from typing import Unpack

from lidcam.evaluation.evaluate import evaluate_result
from lidcam.evaluation.evaluation import Evaluation, make_evaluation_job
from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.requirement import Requirement, RequirementError
from lidcam.inspection import Inspection, inspect_recording
from lidcam.notebook.decoded import decode_clouds, decode_images
from lidcam.notebook.loaded import load_result
from lidcam.notebook.result import ObjectCollector, RunResult, ShownInspection
from lidcam.pipeline.core.clouds import CombinedCloud, PointCloud
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Detections, Fused, Matches
from lidcam.pipeline.core.errors import (
    CalibrationError,
    ConfigError,
    FrameError,
    LidcamError,
    MessageError,
    ModelError,
    OutputError,
    RecordingError,
)
from lidcam.pipeline.core.frame import FrameResult, SensorBundle
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.given import Found2D, Found3D
from lidcam.processing import RunObserver, process_recording
from lidcam.processing import iter_frames as frames_of
from lidcam.readers import open as containers
from lidcam.readers.recording import Loss, Recording
from lidcam.readers.rig.rig_file import load_rig
from lidcam.readers.rig.schema import RigFile
from lidcam.readers.rig.sensor_topics import SensorFault
from lidcam.run.choice import UsedSettings, choose_settings
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput
from lidcam.run.job import FilePath, Job, PathOrUrl, RigSource, Settings, locations, make_job
from lidcam.run.missing import MissingSensor
from lidcam.run.options import JobOptions
from lidcam.run.summary import DropCount, RunSummary, UnusedTopic
from lidcam.run.tally import RunProgress
from lidcam.run.warning import RunWarning
from lidcam.writers.tables.objects import Objects

__all__ = [
    "Boxes2D",
    "Boxes3D",
    "CalibrationError",
    "CombinedCloud",
    "Config",
    "ConfigError",
    "Detections",
    "DropCount",
    "Evaluation",
    "Found2D",
    "Found3D",
    "Frame",
    "FrameError",
    "FrameResult",
    "Fused",
    "Inspection",
    "Job",
    "JobOptions",
    "LidcamError",
    "Loss",
    "Matches",
    "MessageError",
    "MissingSensor",
    "ModelError",
    "NamedFigures",
    "Objects",
    "OutputError",
    "PointCloud",
    "RawMessage",
    "Recording",
    "RecordingError",
    "Requirement",
    "RequirementError",
    "Rig",
    "RigFile",
    "RunInput",
    "RunObserver",
    "RunProgress",
    "RunResult",
    "RunSummary",
    "RunWarning",
    "SensorBundle",
    "SensorFault",
    "UnusedTopic",
    "UsedSettings",
    "__version__",
    "decode_clouds",
    "decode_images",
    "evaluate",
    "inspect",
    "iter_frames",
    "load",
    "load_config",
    "load_rig",
    "make_job",
    "open_recording",
    "process",
    "process_recording",
]

__version__ = version("lidcam")


def process(
    recording: PathOrUrl | Sequence[PathOrUrl],
    output: FilePath | Sequence[FilePath] | None = None,
    *,
    on_frame: Callable[[Frame], None] | None = None,
    progress: bool = False,
    **options: Unpack[JobOptions],
) -> RunResult:
    """Turn a recording into fused objects.

    Args:
        recording: Path or URL; several for a recording that was split, in their order.
        output: File to write, or several: .mcap, .rrd (Rerun), .csv or .parquet (a table of the objects), .mp4 (a
            film), .html (a page) beside an .mcap; None writes none.
        on_frame: Called with each frame, in order, once its tracks are known.
        progress: Show a progress bar, below the cell of a notebook or on a terminal.
        **options: See `JobOptions`.

    Raises:
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    job = make_job(recording, output, **options)
    with ExitStack() as stack:
        collector = ObjectCollector(on_frame, _progress_bar(stack) if progress else None)
        summary = process_recording(job, collector)
    return RunResult(summary, collector.objects)


def _progress_bar(stack: ExitStack) -> RunObserver:
    from lidcam.cli.printing.running import ShownProgress  # with rich, which takes a while to load

    return ShownProgress(stack, whatever_is_logged=True)


def iter_frames(
    recording: PathOrUrl | Sequence[PathOrUrl], **options: Unpack[JobOptions]
) -> Generator[Frame, None, None]:
    """The frames of a recording, one by one, without writing anything; options as in `process`.

    With offline tracks (`track.mode`) the first frame comes once `track.window_s` of the recording have been read.

    Raises:
        LidcamError: the input, the calibration or the settings are at fault.
    """
    return frames_of(make_job(recording, **options))


def inspect(
    recording: PathOrUrl | Sequence[PathOrUrl],
    *,
    config: Config | FilePath | None = None,
    settings: Settings = (),
    rig: RigSource | None = None,
) -> Inspection:
    """The contents of a recording, and what lidcam would use of them; arguments as in `process`.

    Raises:
        LidcamError: the recording cannot be opened or is empty, or the settings or the rig are at fault.
    """
    return ShownInspection.of(inspect_recording(locations(recording), choose_settings(config, settings), rig))


def load(result: FilePath) -> RunResult:
    """A run, read back from the .mcap file that it wrote: the same objects, and the summary but for times of the clock.

    Raises:
        RecordingError: it cannot be read, or is no result of lidcam.
    """
    return RunResult(*load_result(Path(result)))


def evaluate(
    result: FilePath,
    *,
    truth: PathOrUrl | Sequence[PathOrUrl] = (),
    truth_topic: str = "",
    requirements: str | Requirement | Sequence[str | Requirement] = (),
    rig: RigSource | None = None,
    config: FilePath | None = None,
    settings: Settings = (),
) -> Evaluation:
    """Evaluate a result, with and without ground truth.

    Args:
        result: The .mcap file that a run wrote.
        truth: Ground truth: a recording with truth topics, or labels; several add up. Default: the topics copied into
            the result.
        truth_topic: Ground-truth topic; default: found by name.
        requirements: Limits that the figures must meet, `["fused.car.recall >= 0.8"]`; `Evaluation.failures` lists
            those that are not met.
        rig: Rig files to take zones and ground-truth vehicles from, instead of the result's.
        config: A preset or a YAML file to take the section `evaluate` from, instead of the result's.
        settings: Single settings by key, of the sections that an evaluation reads: `{"evaluate.max_range_m": 40}`.

    Raises:
        RequirementError: a requirement cannot be parsed, or names an unknown figure.
        LidcamError: the result, the truth, the rig or the settings are at fault.
    """
    return evaluate_result(
        make_evaluation_job(
            result,
            truth=truth,
            truth_topic=truth_topic,
            requirements=requirements,
            rig=rig,
            config=config,
            settings=settings,
        )
    )


def open_recording(recording: PathOrUrl | Sequence[PathOrUrl]) -> Recording:
    """An open recording, to be used in a `with` block: its topics, and its messages as they were recorded.

    Raises:
        RecordingError: it cannot be read.
    """
    return containers.open_recording(locations(recording))
