"""The names of `import lidcam`: the runs of the command line, with results to work on."""

from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack
from functools import partial
from importlib.metadata import version
from os import PathLike, fspath
from pathlib import Path
from typing import Literal, Unpack

from lidcam.bags import SAMPLE
from lidcam.batches.records import BatchResult, JobRecord
from lidcam.evaluation.compare import ComparedResults, compare_results
from lidcam.evaluation.evaluate import evaluate_result
from lidcam.evaluation.evaluation import Evaluation, as_texts, make_evaluation_job
from lidcam.evaluation.figures import NamedFigures
from lidcam.evaluation.requirement import Requirement, RequirementError
from lidcam.inspection import Inspection, inspect_recording
from lidcam.networks.fetch import fetch_network, is_fetched
from lidcam.networks.known import NETWORKS, NetworkName, network_path
from lidcam.notebook.counting import LineCount
from lidcam.notebook.decoded import decode_clouds, decode_images
from lidcam.notebook.loaded import load_result
from lidcam.notebook.result import (
    ObjectCollector,
    RunResult,
    ShownBatch,
    ShownComparison,
    ShownEvaluation,
    ShownInspection,
)
from lidcam.notebook.site_map import SiteMap, read_site_map
from lidcam.outputs.export.export import Exported, export_results
from lidcam.outputs.export.frames import ExportOptions
from lidcam.outputs.registry import DatasetFormat
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
from lidcam.readers.rig.schema import RigFile
from lidcam.readers.rig.sensor_topics import SensorFault
from lidcam.run.choice import UsedSettings, choose_settings
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput
from lidcam.run.job import ALL_OPTIONS, FilePath, Job, PathOrUrl, RigSource, Settings, locations, make_job, read_rig
from lidcam.run.missing import MissingSensor
from lidcam.run.options import JobOptions, SharedOptions, with_job_keywords
from lidcam.run.summary import DropCount, RunSummary, UnusedTopic
from lidcam.run.tally import RunProgress
from lidcam.run.warning import RunWarning
from lidcam.writers.tables.objects import Objects

__all__ = [
    "BatchResult",
    "Boxes2D",
    "Boxes3D",
    "CalibrationError",
    "CombinedCloud",
    "ComparedResults",
    "Config",
    "ConfigError",
    "Detections",
    "DropCount",
    "Evaluation",
    "Exported",
    "Found2D",
    "Found3D",
    "Frame",
    "FrameError",
    "FrameResult",
    "Fused",
    "Inspection",
    "Job",
    "JobOptions",
    "JobRecord",
    "LidcamError",
    "LineCount",
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
    "SharedOptions",
    "SiteMap",
    "UnusedTopic",
    "UsedSettings",
    "__version__",
    "batch",
    "compare",
    "decode_clouds",
    "decode_images",
    "evaluate",
    "export",
    "fetch",
    "inspect",
    "iter_frames",
    "load",
    "load_config",
    "load_rig",
    "make_job",
    "open_recording",
    "process",
    "process_recording",
    "report",
    "sample",
    "simulate",
]

__version__ = version("lidcam")


def sample() -> Path:
    """The sample recording that comes with lidcam: 2 s of a model crossing, three lidars and eight cameras, simulated.

    Read it in place, and write outputs elsewhere.
    """
    return SAMPLE


@with_job_keywords(*ALL_OPTIONS)
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
        **options: Those of [`SharedOptions`][lidcam.api.SharedOptions] and [`JobOptions`][lidcam.api.JobOptions].

    Returns:
        The objects of all frames, and a summary of the run.

    Raises:
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    job = make_job(recording, output, **options)
    with ExitStack() as stack:
        collector = ObjectCollector(on_frame, _progress_bar(stack) if progress else None)
        summary = process_recording(job, collector)
    return collector.result(summary)


def _progress_bar(stack: ExitStack) -> RunObserver:
    from lidcam.cli.printing.running import ShownProgress  # with rich, which takes a while to load

    return ShownProgress(stack, whatever_is_logged=True)


@with_job_keywords(*ALL_OPTIONS)
def iter_frames(
    recording: PathOrUrl | Sequence[PathOrUrl], **options: Unpack[JobOptions]
) -> Generator[Frame, None, None]:
    """Process a recording frame by frame, without writing anything.

    With offline tracks (`track.mode`) the first frame comes once `track.window_s` of the recording have been read.
    Leaving the loop closes the recording.

    Args:
        recording: Path or URL; several for a recording that was split, in their order.
        **options: Those of [`SharedOptions`][lidcam.api.SharedOptions] and [`JobOptions`][lidcam.api.JobOptions].

    Raises:
        LidcamError: the input, the calibration or the settings are at fault.
    """
    return frames_of(make_job(recording, **options))


@with_job_keywords(*SharedOptions.__annotations__)
def batch(
    recordings: FilePath | Sequence[FilePath],
    output: PathOrUrl,
    *,
    jobs: int | None = None,
    engine: Literal["local", "ray"] = "local",
    address: str | None = None,
    rerun: bool = False,
    report: bool = False,
    objects: bool = False,
    video: bool = False,
    overwrite: bool = False,
    progress: bool = False,
    **options: Unpack[SharedOptions],
) -> BatchResult:
    """Process many recordings, each in a process of its own: one result each, and a summary table.

    A second call processes only what is missing or changed: recording, settings, rig, network or version. If one
    recording fails, the others go on.

    Args:
        recordings: Recordings, folders (also s3://bucket/folder), patterns ('logs/*.bag'), URLs, or '@list.txt' with
            one of these per line.
        output: Folder for the results; may be s3://bucket/folder.
        jobs: Recordings at once. Default: as many as cores and memory allow.
        engine: Processes on this machine, or Ray tasks (extra ray).
        address: Ray cluster, HOST:PORT or auto. Default: start Ray on this machine.
        rerun: Also write Rerun recordings.
        report: Also write pages about the results.
        objects: Also write Parquet tables of the objects.
        video: Also write films (extra video).
        overwrite: Reprocess results that are up to date, and overwrite other files.
        progress: Show a progress bar, below the cell of a notebook or on a terminal.
        **options: Those of [`SharedOptions`][lidcam.api.SharedOptions].

    Returns:
        The record of each recording, as in the table `_jobs.parquet` of the folder.

    Raises:
        LidcamError: the settings, the rig or the folder are at fault, or there are no recordings. Errors of a recording
            are in its record.
    """
    from lidcam.batches.run import WatchBatch, not_watched, process_batch  # with pyarrow

    watch: WatchBatch = not_watched
    if progress:
        from lidcam.cli.printing.batch import shown_batch

        watch = shown_batch
    (place,) = locations(output)
    done = process_batch(
        [fspath(one) for one in ([recordings] if isinstance(recordings, str | PathLike) else recordings)],
        place,
        jobs=jobs,
        engine=engine,
        address=address,
        outputs={"--rerun": rerun, "--report": report, "--objects": objects, "--video": video},
        overwrite=overwrite,
        watch=watch,
        **options,
    )
    return ShownBatch.of(done)


def inspect(
    recording: PathOrUrl | Sequence[PathOrUrl],
    *,
    config: Config | FilePath | None = None,
    settings: Settings = (),
    rig: RigSource | None = None,
) -> Inspection:
    """Show the contents of a recording and what lidcam would use.

    Args:
        recording: Path or URL; several for a recording that was split, in their order.
        config: As in `process`.
        settings: As in `process`.
        rig: As in `process`.

    Returns:
        Topics, sensors with their calibration, faults and warnings.

    Raises:
        LidcamError: the recording cannot be opened or is empty, or the settings or the rig are at fault.
    """
    return ShownInspection.of(inspect_recording(locations(recording), choose_settings(config, settings), rig))


def load(result: FilePath) -> RunResult:
    """A run, read back from its .mcap file: the same objects, and the summary except for wall-clock times.

    Raises:
        RecordingError: it cannot be read, or is no result of lidcam.
    """
    path = Path(result)
    return RunResult(*load_result(path), partial(read_site_map, path.absolute()))


def evaluate(
    result: FilePath,
    *,
    truth: PathOrUrl | Sequence[PathOrUrl] = (),
    truth_topic: str = "",
    requirements: str | Requirement | Sequence[str | Requirement] = (),
    rig: RigSource | None = None,
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
        settings: Single settings by key, of the sections that an evaluation reads: `{"evaluate.max_range_m": 40}`.

    Returns:
        All figures by name, and the requirements that are not met.

    Raises:
        RequirementError: a requirement cannot be parsed, or names an unknown figure.
        LidcamError: the result, the truth, the rig or the settings are at fault.
    """
    job = make_evaluation_job(
        result, truth=truth, truth_topic=truth_topic, requirements=requirements, rig=rig, settings=settings
    )
    return ShownEvaluation.of(evaluate_result(job))


def compare(
    first: FilePath,
    second: FilePath,
    *,
    only: str | Sequence[str] = (),
    allow: str | Sequence[str] = (),
    max_different_percent: float = 0.0,
) -> ComparedResults:
    """Compare two results, object by object.

    Args:
        first: The .mcap file that a run wrote, A.
        second: Another result of the same recording or scene, B.
        only: Sources (fused, lidar, cameras) and cameras to compare. Default: all.
        allow: Kinds of difference to allow, by any amount: lost, new, moved, turned, resized, relabelled, rescored,
            reidentified (objects) or frames (of one result alone).
        max_different_percent: Share of objects, and of frames, that may differ, 0 to 100.

    Returns:
        The differences; `failures` lists what differs more than is allowed.

    Raises:
        LidcamError: a result cannot be read, the results have different site frames, or a name is unknown.
    """
    found = compare_results(
        Path(first), Path(second), only=only, allow=allow, max_different_percent=max_different_percent
    )
    return ShownComparison.of(found)


def export(
    results: FilePath | Sequence[FilePath],
    output: FilePath,
    *,
    format: DatasetFormat,
    only: Literal["confirmed"] | None = None,
    every: int = 1,
    camera: str = "",
    truth: PathOrUrl | Sequence[PathOrUrl] = (),
) -> Exported:
    """Write results as a data set: clouds, images, calibration, boxes.

    Labels are the ground truth if there is any, else lidcam's objects. All formats but yolo and cvat also contain these
    objects as scored detections.

    Args:
        results: The .mcap files that runs wrote, one scene each, with different names.
        output: Folder, which is empty or does not exist.
        format: Layout of the data set.
        only: `confirmed`: only objects that a camera confirms.
        every: Every Nth frame only.
        camera: Camera for KITTI's image_2 (default: the first with images), or the only one of coco and yolo.
        truth: Ground truth: a recording with truth topics, or labels. Default: the topics copied into the results.

    Returns:
        Number of frames and objects, and what was left out and why.

    Raises:
        LidcamError: a result cannot be read or lacks what the format needs, or the folder cannot be written.
    """
    if every < 1:
        raise ConfigError(f"every: expected 1 or more, found {every}")
    if only not in {None, "confirmed"}:
        raise ConfigError(f"only: expected confirmed or None, found {only!r}")
    options = ExportOptions(confirmed=only == "confirmed", every=every, camera=camera, truth=locations(truth))
    paths = [results] if isinstance(results, str | PathLike) else results
    return export_results([Path(path) for path in paths], Path(output), format, options)


def report(result: FilePath, output: FilePath | None = None, *, overwrite: bool = False) -> Path:
    """Write a page about a result: one HTML file that opens in any browser, offline.

    Args:
        result: The .mcap file that a run wrote.
        output: The page. Default: beside the result, with the ending .html.
        overwrite: Overwrite files that lidcam did not write (never the result).

    Returns:
        The page.

    Raises:
        LidcamError: the result cannot be read, or the page cannot be written.
    """
    from lidcam.outputs.report.make import write_page  # with rich

    page = Path(result).with_suffix(".html") if output is None else Path(output)
    write_page(Path(result), page, overwrite=overwrite)
    return page


def simulate(
    scenario: str,
    output: FilePath,
    *,
    duration_s: float | None = None,
    seed: int | None = None,
    family: Literal["sandbox", "crossing", "road"] | None = None,
    errors: bool | None = None,
    settings: Settings = (),
    overwrite: bool = False,
    workers: int | None = None,
) -> Path:
    """Record a simulated scene: lidars, cameras, and ground truth. Needs the extra sim.

    In a script, call it below `if __name__ == "__main__":`, as its processes import the script.

    Args:
        scenario: sandbox, crossing, vehicle, random, or a YAML file.
        output: The recording: .bag (ROS 1) or .mcap (ROS 2).
        duration_s: Seconds to record. Default: the scenario's.
        seed: Seed of the noise, and of a random scenario. Default: the scenario's.
        family: Family of worlds that `random` draws from. Default: road.
        errors: Sensors with small errors, or none. Default: errors for `random` only.
        settings: Single values of the scenario by key: `{"lidars.*.firing_stride": 4}`.
        overwrite: Overwrite files that are not simulated recordings.
        workers: Sensors simulated at once; does not change the recording. Default: one per core.

    Returns:
        The recording.

    Raises:
        LidcamError: the simulator is not installed, there is no such scenario, a value does not fit, or the recording
            cannot be written.
    """
    from lidcam.simulation import simulate_recording

    simulate_recording(
        scenario,
        Path(output),
        duration_s=duration_s,
        seed=seed,
        family=family,
        errors=errors,
        settings=[*as_texts(settings)],
        overwrite=overwrite,
        workers=workers,
    )
    return Path(output)


def fetch(name: NetworkName) -> Path:
    """Download a 2D network from its publisher, once; later calls return that file.

    From then on it runs by default in recordings with images and no 2D boxes. Its licence is Apache-2.0.

    Args:
        name: yolox-nano, yolox-tiny or yolox-s.

    Returns:
        The ONNX file, in your data folder.

    Raises:
        ModelError: the name is unknown, or the server cannot be reached or sends another file.
        OutputError: the file cannot be written.
    """
    if name not in NETWORKS:
        raise ModelError(f"fetch: expected {', '.join(NETWORKS)}, found {name!r}")
    return network_path(Path(name)) if is_fetched(name) else fetch_network(name)


def load_rig(path: FilePath) -> RigFile:
    """A rig file of lidcam, a calibration file of another system (the content says which), or a preset (original).

    Raises:
        CalibrationError: the file cannot be read, or its content does not fit; names the file and the key.
        ConfigError: the file is not a YAML mapping.
    """
    return read_rig(path) or RigFile()


def open_recording(recording: PathOrUrl | Sequence[PathOrUrl]) -> Recording:
    """Open a recording, in a `with` block: its topics, and its messages as recorded.

    Raises:
        RecordingError: it cannot be read.
    """
    return containers.open_recording(locations(recording))
