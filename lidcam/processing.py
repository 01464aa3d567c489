"""A run: open a recording, find its calibration, push its bundles through the stages, write, count.

The command line, a notebook and a worker on a cluster call the same function. Nothing is printed here, and nothing is
kept between runs.
"""

import logging
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from lidcam.checks.boxes import DoubtedCheck, class_number_warnings
from lidcam.checks.calibration.rig_check import CalibrationCheck
from lidcam.checks.clocks import clock_notes, sync_warnings
from lidcam.checks.messages import CameraCheck, GroundCheck, LidarCheck, MotionCheck, check_not_empty
from lidcam.checks.no_objects import ObjectCheck
from lidcam.outputs.allowed import check_no_input
from lidcam.outputs.copied import choose_copied, choose_drawn, truth_frames
from lidcam.outputs.open import how_to_open, make_pages, open_outputs, open_writers, written_files
from lidcam.outputs.provenance import input_files, provenance_of
from lidcam.outputs.writers import drawn_scenes
from lidcam.pipeline.core.errors import ConfigError, RecordingError, short_memory_told
from lidcam.pipeline.core.frame import FrameResult, SensorBundle
from lidcam.pipeline.parallel.cores import usable_cores
from lidcam.pipeline.parallel.process import WorkerProcess, copied_workers
from lidcam.pipeline.stages.sync.synchronize import SyncStats
from lidcam.pipeline.tracking.trackers import object_tracker
from lidcam.readers.input_file import InputFile, InputFiles, read_input_file
from lidcam.readers.open import open_recording
from lidcam.readers.recording import ReadOptions
from lidcam.readers.rig.discovery import Discovery, discover_rig
from lidcam.readers.rig.sensor_topics import faults_told
from lidcam.readers.streams.per_sensor import sensor_messages
from lidcam.run.box_sources import KnownBoxes, box_source, boxes_2d_words, check_box_source, engine_3d
from lidcam.run.build import build_graph, decided, shared_results
from lidcam.run.choice import use_settings
from lidcam.run.effect import named_files, settings_sha256
from lidcam.run.first_look import corrected_by_recording, with_agreeing_lidars, with_corrections
from lidcam.run.frame import Frame
from lidcam.run.frames import (
    RunInput,
    bundles,
    expected_frames,
    missing_from_frames,
    no_frames,
    reference_topic,
    sensor_clocks,
    time_window,
)
from lidcam.run.job import Job
from lidcam.run.missing import MissingSensor
from lidcam.run.scene import find_motion, on_level_site
from lidcam.run.summary import InputSummary, RunSummary, SensorSummary, TimingSummary, camera_corrections, unused_topics
from lidcam.run.tally import DropTable, RunProgress, Tally
from lidcam.run.tracks import tracked
from lidcam.run.warning import RunWarning
from lidcam.writers.base import ResultWriter

logger = logging.getLogger(__name__)


class RunObserver:
    """Observes a run; the methods of this class do nothing."""

    def opened(self, source: RunInput) -> None:
        """The recording is open and its sensors are known."""

    def frame(self, result: Frame) -> None:
        """A frame has its tracks and is written. Frames arrive in order; with offline tracks, up to a window late."""

    def advanced(self, progress: RunProgress) -> None:
        """A frame has passed the stages, or is written."""

    def finishing(self) -> None:
        """All frames are written; what is made of the result, such as a report, follows."""


def process_recording(job: Job, observer: RunObserver | None = None) -> RunSummary:
    """Process a recording to its end.

    Args:
        job: The recording, the settings and the outputs.
        observer: Observes the run.

    Raises:
        LidcamError: the input, the calibration, the settings or an output is at fault, or memory runs short; no output
            is left behind.
    """
    observer = observer or RunObserver()
    named = {key: read_input_file(path) for key, path in named_files(job.config).items()}
    with ExitStack() as views, open_outputs(job) as outputs, opened(job) as run:
        written = written_files(job)
        with ExitStack() as stack:
            observer.opened(run.source)
            inputs = stack.enter_context(closing(input_files(run.source, named, is_written=bool(written))))
            provenance = provenance_of(job, run.source, inputs, run.summary)
            writers = open_writers(job, run.source, provenance, outputs, views, stack)
            # Closed before the writers are, also when the observer raises: then no stage is at work any more.
            folder = written[0].parent if written else None
            frames = stack.enter_context(closing(run.frames(writers, folder, partial(_advance, run, inputs, observer))))
            for frame in frames:
                observer.frame(frame)
            whole = inputs.finish()
        observer.finishing()
        make_pages(job, outputs)
        changed = [file.path for file in (*whole, *inputs.named.values()) if file.is_changed]
        return run.summary(whole, written, how_to_open(job), changed)


def iter_frames(job: Job) -> Generator[Frame, None, None]:
    """The frames of a recording, in order, with their tracks; closes the recording when it ends or is closed.

    With offline tracks the first frame comes once `track.window_s` of the recording have been read.

    Raises:
        LidcamError: the input, the calibration or the settings are at fault.
    """
    with opened(job) as run:
        yield from run.frames()


@contextmanager
def opened(job: Job) -> Iterator["Run"]:
    """A run, ready to begin; raises `LidcamError` as `process_recording` does."""
    options = ReadOptions("as_needed" if job.on_bad_message == "skip" else "none", job.config.limits)
    with (
        short_memory_told(f"process {', '.join(map(str, job.inputs))}"),
        sensor_messages(open_recording(job.inputs, options), limits=options.limits) as recording,
    ):
        seconds, topics = (recording.end_ns - recording.start_ns) / 1e9, len(recording.topics)
        files = ", ".join(map(str, recording.paths))
        logger.info("%s: %d messages of %d topics, %.3f s", files, recording.message_count, topics, seconds)
        for path in dict.fromkeys(loss.path for loss in recording.losses):
            logger.warning("%s is damaged or was not closed: what can still be read is read", path)
        check_not_empty(recording)
        check_no_input(written_files(job), recording.paths)
        window = time_window(recording, job.start_s, job.duration_s)
        discover = partial(discover_rig, recording, job.config, start_ns=window.start_ns, stop_ns=window.stop_ns)
        found = on_level_site(discover(job.rig), recording, job.config, job.rig, discover)
        for subjects, reason in faults_told(found.faults):
            logger.warning("left out: %s: %s", subjects, reason)
        for sensor in found.sources:
            known = ", ".join(filter(None, (sensor.intrinsics, sensor.extrinsics)))
            logger.info("%s: %s, calibration: %s", sensor.sensor, sensor.topic, known)
        motion, found = find_motion(recording, job.config, found)
        config, used, found = use_settings(job.settings, recording, found, job.rig, moves=motion is not None)
        logger.info("settings: %s", used)
        copied, notes = choose_copied(job.outputs, recording, found.rig, config)
        found = replace(found, notes=(*found.notes, *notes))
        drops = DropTable(job.on_bad_message)
        drawn = choose_drawn(recording, copied)
        frames = truth_frames(recording, copied, found, config)
        source = RunInput(recording, found.rig, config, motion, window, used, copied, drawn, frames, job.given)
        run = Run(source, found, drops)
        with run.workers_started():
            yield run


class Run:
    """One pass over an open recording.

    Attributes:
        source: The recording, its sensors, with the cameras as corrected by the recording, and the settings.
        found: How the sensors were found.
    """

    def __init__(self, source: RunInput, found: Discovery, drops: DropTable) -> None:
        started = time.perf_counter()
        reference_topic(source.config, source.rig)
        known = KnownBoxes()
        self._workers = _workers(source)
        source = with_agreeing_lidars(source)
        source = corrected_by_recording(source, known, self._workers)
        first_look_s = time.perf_counter() - started
        self.source, self.found = source, with_corrections(found, source.rig)
        self._drops, self._tally, self._stats = drops, Tally(source.config, source.rig), SyncStats()
        self._passed, self._detections, self._log_time_ns = 0, 0, source.recording.start_ns
        self._clocks = sensor_clocks(source.rig, source.motion, drops)
        self._checks = (
            LidarCheck(source.rig),
            GroundCheck(source.config.combine.ground),
            MotionCheck(source.rig, source.motion.topics if source.motion else ()),
            CameraCheck(source.rig),
            CalibrationCheck(source.rig, source.config, source.compared),
            ObjectCheck(
                source.recording,
                source.rig,
                source.config,
                source.settings,
                moves=source.motion is not None or source.settings.moves,
            ),
            DoubtedCheck(
                source.config,
                has_2d_boxes=box_source(source.config, source.rig) != "none",
                has_images=any(camera.topic for camera in source.rig.cameras),
            ),
        )
        self._make_graph = partial(build_graph, source.config, source.rig, known, source.given, on_bad=drops.on_bad)
        self._graph, self._result = self._make_graph()
        self._graph.seconds = {"first look": first_look_s, "read": 0.0, **self._graph.seconds}
        self._tracker = object_tracker(decided(source.config, source.rig), source.rig)
        check_box_source(source.config, source.recording, source.rig)
        self._processes: Sequence[WorkerProcess] = ()
        self._seconds = time.perf_counter() - started  # loading a network belongs to a run

    @contextmanager
    def workers_started(self) -> Iterator[None]:
        """Start the processes that share the work, before outputs are opened, which may start threads."""
        graph, result, frames = self._graph, self._result, expected_frames(self.source)
        with copied_workers(graph, result, workers=self._workers, frames=frames) as self._processes:
            yield

    def frames(
        self,
        writers: Sequence[ResultWriter] = (),
        folder: Path | None = None,
        advanced: Callable[[], None] = lambda: None,
    ) -> Generator[Frame, None, None]:
        """The frames, in order, with their tracks, each written before it is yielded; to be read once.

        `advanced` is called after each that has passed the stages, and after each that was yielded.
        """
        started, graph, scenes = time.perf_counter(), self._graph, drawn_scenes(self.source)
        self._count_early_drops()
        with ExitStack() as stack:
            frames = stack.enter_context(closing(self._results(advanced)))
            if self._tracker is not None:
                stage = partial(graph.stage, "track")
                frames = stack.enter_context(closing(tracked(frames, self._tracker, folder, stage)))
            for frame in frames:
                for writer in writers:
                    with graph.stage(f"write {writer.name}", frame.bundle):
                        frame = _written(frame, writer)
                with graph.stage("count and check", frame.bundle):
                    self._tally.add_frame(frame)
                    for check in self._checks:
                        check.add_frame(frame)
                for drop in frame.drops:
                    self._drops.count_bad(drop)
                bundle, objects = frame.bundle, len(frame.fused.objects)
                facts = bundle.index, bundle.stamp_ns, len(bundle.messages), objects
                logger.debug("frame %d, %d ns: %d topics, %d objects", *facts)
                yield Frame.of(frame, scenes, self.source.rig, self.source.config.object_names)
                advanced()
        self._seconds += time.perf_counter() - started
        if self._tally.frames == 0:
            raise RecordingError(no_frames(self.source, self._drops))

    def _results(self, advanced: Callable[[], None]) -> Generator[FrameResult, None, None]:
        found = shared_results(
            (self._graph, self._result),
            self._read(),
            self.source,
            make_graph=self._make_graph,
            workers=self._workers,
            expected=expected_frames(self.source),
            started=self._processes,
        )
        with closing(found) as frames:
            for frame in frames:
                self._passed, self._log_time_ns = self._passed + 1, frame.bundle.log_time_ns
                self._detections += len(frame.fused.objects)
                yield frame
                advanced()

    def _read(self) -> Iterator[SensorBundle]:
        found = bundles(self.source, self._drops, self._stats, self._clocks)
        while True:
            started = time.perf_counter()
            bundle = next(found, None)
            self._graph.seconds["read"] += time.perf_counter() - started
            if bundle is None:
                return
            yield bundle

    @property
    def progress(self) -> RunProgress:
        """The progress of the run."""
        return RunProgress(self._passed, self._tally.frames, self._detections, self._drops.total, self._log_time_ns)

    def summary(
        self,
        inputs: Sequence[InputFile] = (),
        outputs: Sequence[Path] = (),
        viewers: Mapping[str, str] | None = None,
        changed: Sequence[str] = (),
    ) -> RunSummary:
        """The summary so far, with the files that were read, written, and changed while they were read."""
        source, found, tally, drops = self.source, self.found, self._tally, self._drops.rows
        motion_topics = source.motion.topics if source.motion else ()
        used = {*tally.messages, *(drop.topic for drop in drops), *motion_topics, *source.copied}
        missing = missing_from_frames(source, self._stats)
        return RunSummary(
            inputs=InputSummary(
                files=tuple(inputs),
                changed=tuple(changed),
                messages_used=dict(sorted(tally.messages.items())),
                copied={topic: tally.copied[topic] for topic in sorted(source.copied)},
                unused_topics=unused_topics(source.recording, used),
                losses=source.recording.losses,
            ),
            frames=tally.frame_summary(self._stats),
            drops=tally.drop_summary(drops),
            sensors=SensorSummary(
                rig=source.rig,
                calibration=found.sources,
                faults=found.faults,
                missing=tuple(missing),
                box_source=box_source(source.config, source.rig),
                box_source_3d=engine_3d(source.config),
                motion_topics=motion_topics,
                corrections=camera_corrections(source.rig),
                box_words=boxes_2d_words(source.config, source.rig),
            ),
            timing=TimingSummary(
                stage_seconds=dict(self._graph.seconds),
                wall_seconds=self._seconds,
                frames_per_second=tally.frames / self._seconds if self._seconds else 0.0,
            ),
            settings=source.settings,
            settings_sha256=settings_sha256(source.config),
            notes=(*found.notes, *clock_notes(self._clocks, source.rig.sensor_of_topic)),
            warnings=tuple(self._warnings(missing)),
            outputs=tuple(outputs),
            how_to_open=viewers or {},
            road_users=tally.road_users.road_users,
        )

    def _warnings(self, missing: Sequence[MissingSensor]) -> Iterator[RunWarning]:
        tally = self._tally
        yield from sync_warnings(self._clocks, self._stats, missing, self._drops.rows, self.source)
        yield from class_number_warnings(tally.unused_boxes, tally.unused_boxes3d, self.source.config)
        for check in self._checks:
            yield from check.warnings

    def _count_early_drops(self) -> None:
        """Count messages that were found bad during the search for the rig; those of the motion are read again."""
        motion_topics = self.source.motion.topics if self.source.motion else ()
        for drop, count in self.found.transforms.drops:
            if drop.topic not in motion_topics:
                for _ in range(count):
                    self._drops.count_bad(drop)


def _workers(source: RunInput) -> int:
    """Most processes of a run."""
    wanted = source.config.run.workers
    reason = "" if wanted == 1 else source.given.unsendable
    if not reason:
        return wanted or usable_cores()
    if wanted:
        raise ConfigError(f"{reason}, or set workers to 1")
    logger.warning("%s; until then, one process does all the work", reason)
    return 1


def _advance(run: Run, inputs: InputFiles, observer: RunObserver) -> None:
    progress, recording = run.progress, run.source.recording
    logged_ns, all_ns = progress.log_time_ns - recording.start_ns, recording.end_ns - recording.start_ns
    inputs.read_up_to(logged_ns / max(all_ns, 1))
    observer.advanced(progress)


def _written(result: FrameResult, writer: ResultWriter) -> FrameResult:
    not_copied = writer.write(result)
    return replace(result, drops=result.drops + not_copied) if not_copied else result
