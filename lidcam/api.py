"""What `import lidcam` offers: the same runs that the command line makes, with results to work on."""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from lidcam.inspection import Inspection, inspect_recording
from lidcam.job import FilePath, Job, PathOrUrl, locations, make_job
from lidcam.job import read_config as load_config
from lidcam.objects import ObjectCollector, Objects
from lidcam.run import RunObserver, process_recording
from lidcam.run import iter_frames as frames_of
from lidcam.summary import DropCount, RunReport
from pipeline.core.clouds import CombinedCloud, PointCloud
from pipeline.core.detections import Boxes2D, Boxes3D, Detections, Fused, Matches
from pipeline.core.errors import (
    CalibrationError,
    ConfigError,
    FrameError,
    LidcamError,
    MessageError,
    ModelError,
    OutputError,
    RecordingError,
)
from pipeline.core.frame import FrameResult, SensorBundle
from pipeline.core.messages import RawMessage
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from readers import open as containers
from readers.recording import Recording
from readers.rig.rig_file import load_rig
from readers.rig.schema import RigFile
from readers.streams.decoders import OnBadMessage

__all__ = [
    "Boxes2D",
    "Boxes3D",
    "CalibrationError",
    "CombinedCloud",
    "Config",
    "ConfigError",
    "Detections",
    "DropCount",
    "FrameError",
    "FrameResult",
    "Fused",
    "Inspection",
    "Job",
    "LidcamError",
    "Matches",
    "MessageError",
    "ModelError",
    "Objects",
    "OutputError",
    "PointCloud",
    "RawMessage",
    "Recording",
    "RecordingError",
    "Rig",
    "RunObserver",
    "RunReport",
    "RunResult",
    "SensorBundle",
    "__version__",
    "inspect",
    "iter_frames",
    "load_config",
    "load_rig",
    "make_job",
    "open_recording",
    "process",
    "process_recording",
]

__version__ = version("lidcam")


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """A finished run.

    Attributes:
        report: What was done: counts, drops, calibration, times.
        objects: The fused objects of all frames.
    """

    report: RunReport
    objects: Objects

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.report.frames

    @property
    def drops(self) -> tuple[DropCount, ...]:
        """Messages that were not used, by topic and reason."""
        return self.report.drops


class _Watcher(ObjectCollector):
    def __init__(self, class_names: tuple[str, ...], on_frame: Callable[[FrameResult], None] | None) -> None:
        super().__init__(class_names)
        self._on_frame = on_frame

    def frame(self, result: FrameResult) -> None:
        super().frame(result)
        if self._on_frame is not None:
            self._on_frame(result)


def process(
    recording: PathOrUrl | Sequence[PathOrUrl],
    output: FilePath | Sequence[FilePath] | None = None,
    *,
    config: Config | FilePath | None = None,
    settings: Mapping[str, object] | Sequence[str] = (),
    rig: RigFile | FilePath | None = None,
    model_2d: FilePath | None = None,
    workers: int | None = None,
    start_s: float = 0.0,
    duration_s: float | None = None,
    on_bad_message: OnBadMessage = "skip",
    on_frame: Callable[[FrameResult], None] | None = None,
) -> RunResult:
    """Turn a recording into fused objects.

    Args:
        recording: Path or URL; several for a recording that was split, in their order.
        output: File to write, or several: .mcap, .rrd (Rerun); None writes none.
        config: Settings, or a YAML file of them.
        settings: Single settings on top: `{"sync.slop_s": 0.05}` or `["sync.slop_s=0.05"]`.
        rig: Rig file, loaded or by its path; without it sensors and calibration are found in the recording.
        model_2d: 2D network (ONNX, YOLOX layout).
        workers: 1 runs stage after stage; more overlap stages of several frames. The result is the same.
        start_s: Seconds to skip.
        duration_s: Seconds to process; None: to the end.
        on_bad_message: Whether a message that cannot be decoded is skipped and counted, or ends the run.
        on_frame: Called with each frame, in order.

    Raises:
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    job = make_job(
        recording,
        output,
        config=config,
        settings=settings,
        rig=rig,
        model_2d=model_2d,
        workers=workers,
        start_s=start_s,
        duration_s=duration_s,
        on_bad_message=on_bad_message,
    )
    watcher = _Watcher(job.config.class_names, on_frame)
    report = process_recording(job, watcher)
    return RunResult(report, watcher.objects)


def iter_frames(
    recording: PathOrUrl | Sequence[PathOrUrl],
    *,
    config: Config | FilePath | None = None,
    settings: Mapping[str, object] | Sequence[str] = (),
    rig: RigFile | FilePath | None = None,
    model_2d: FilePath | None = None,
    workers: int | None = None,
    start_s: float = 0.0,
    duration_s: float | None = None,
    on_bad_message: OnBadMessage = "skip",
) -> Generator[FrameResult, None, None]:
    """The frames of a recording, one after another, without writing anything; arguments as of `process`.

    Raises:
        LidcamError: the input, the calibration or the settings are at fault.
    """
    return frames_of(
        make_job(
            recording,
            config=config,
            settings=settings,
            rig=rig,
            model_2d=model_2d,
            workers=workers,
            start_s=start_s,
            duration_s=duration_s,
            on_bad_message=on_bad_message,
        )
    )


def inspect(
    recording: PathOrUrl | Sequence[PathOrUrl],
    *,
    config: Config | FilePath | None = None,
    settings: Mapping[str, object] | Sequence[str] = (),
    rig: RigFile | FilePath | None = None,
) -> Inspection:
    """What is in a recording, and what lidcam would use of it; arguments as of `process`.

    Raises:
        LidcamError: the recording cannot be opened or is empty, or the settings or the rig are at fault.
    """
    rig_file = rig if rig is None or isinstance(rig, RigFile) else load_rig(Path(rig))
    return inspect_recording(locations(recording), load_config(config, settings), rig_file)


def open_recording(recording: PathOrUrl | Sequence[PathOrUrl]) -> Recording:
    """An open recording, to be used in a `with` block: its topics, and its messages as they were recorded.

    Raises:
        RecordingError: it cannot be read.
    """
    return containers.open_recording(locations(recording))
