"""A result of lidcam, frame by frame.

The messages of a frame have one log time and stand together, the fused objects first (see `McapResultWriter`). Only
the topics of boxes, `/tracks` and `/diagnostics` are read.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import UNKNOWN_CLASS, Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.evaluation.evaluation_frame import SOURCES, UNKNOWN, FrameSync, Motion, ResultFrame, SourceBoxes
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.detections import (
    DETECTIONS_2D,
    DETECTIONS_3D,
    Detections3D,
    decode_detections2d,
    decode_detections3d,
    track_ids,
)
from lidcam.readers.messages.objects import TRACKS, ObjectClasses, decode_tracks
from lidcam.readers.notes import Notes
from lidcam.readers.open import open_recording
from lidcam.readers.recording import DEFAULT_READ_OPTIONS, Closing, ReadOptions, Recording
from lidcam.readers.results.attached import attached_config, attached_rig, attached_summary
from lidcam.readers.results.attached_records import CONFIG, RIG, SUMMARY, read_records

SOURCE_TOPICS = {source: f"/{source}/detections" for source in SOURCES}
"""Topics of 3D boxes by source."""

RESULT_TOPICS = frozenset(SOURCE_TOPICS.values())
"""Topics of 3D boxes that are results, not truth."""

TRACKS_TOPIC = "/tracks"
"""Topic of the tracks of the fused objects, with their motion."""

DIAGNOSTICS = "/diagnostics"
"""Topic of the counts of each frame."""

SYNCHRONISATION = "lidcam: synchronisation"
"""Diagnostic status that has the skew."""


class Result(Closing):
    """An open result; `open_result` opens one.

    Attributes:
        path: The file.
        recording: Its messages.
        metadata: Its origin: version of lidcam, inputs with their hashes, hashes of settings and rig.
        config: Its settings.
        rig: Its rig.
        sources: Sources of 3D boxes that it has, in the order of `SOURCES`.
        cameras: Names of the cameras that it has 2D boxes of, in the order of the rig.
        summary: What the run used, dropped and warned of (`lidcam.outputs.provenance`); empty of a file that was not
            closed.
    """

    def __init__(
        self,
        path: Path,
        recording: Recording,
        metadata: Mapping[str, str],
        config: Config,
        rig: Rig,
        notes: Sequence[str],
        summary: Mapping[str, Any] | None = None,
    ) -> None:
        self.path, self.recording, self.metadata, self.config, self.rig = path, recording, metadata, config, rig
        self._notes, self.summary = tuple(notes), summary or {}
        self._unused = Notes()
        self._class_ids = {name: class_id for class_id, name in enumerate(config.class_names)}
        recorded = {info.topic for info in recording.topics if info.msgtype in {DETECTIONS_2D, DETECTIONS_3D}}
        self.sources = tuple(source for source, topic in SOURCE_TOPICS.items() if topic in recorded)
        self._tracks_topics = [
            info.topic for info in recording.topics if info.topic == TRACKS_TOPIC and info.msgtype == TRACKS
        ]
        self.cameras = tuple(camera.name for camera in rig.cameras if _boxes_topic(camera.name) in recorded)

    @property
    def is_adrift(self) -> bool:
        """Whether the sensors move, and the result does not say where to: motion sought in the clouds, for tracks."""
        motion = self.summary.get("motion") or {"topics": [], "frames_from_clouds": 0}
        return bool(motion["frames_from_clouds"]) and not motion["topics"]

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user about what was read, one line each."""
        losses = [f"{loss.path}: byte {loss.position}: {loss.reason}" for loss in self.recording.losses]
        return (*self._notes, *losses, *(f"{self.path.name}: {line}" for line in self._unused.lines()))

    def frames(self) -> Iterator[ResultFrame]:
        """The frames, in the order in which they were written."""
        boxes = [SOURCE_TOPICS[source] for source in self.sources] + [*map(_boxes_topic, self.cameras)]
        topics = [*boxes, *self._tracks_topics, DIAGNOSTICS]
        yield from (self._frame(index, messages) for index, messages in enumerate(self.messages_of_frames(topics)))

    def messages_of_frames(self, topics: Sequence[str]) -> Iterator[Mapping[str, RawMessage]]:
        """The messages of each frame by topic, in the order in which they were written."""
        messages: dict[str, RawMessage] = {}
        log_time_ns = 0
        for message in self.recording.messages(topics):
            if messages and (message.log_time_ns != log_time_ns or message.topic in messages):
                yield messages
                messages = {}
            log_time_ns = message.log_time_ns
            messages[message.topic] = message
        if messages:
            yield messages

    def close(self) -> None:
        """Close the file."""
        self.recording.close()

    def _frame(self, index: int, messages: Mapping[str, RawMessage]) -> ResultFrame:
        limits = self.config.limits
        sources, cameras = {}, {}
        skew_ns = sync = None
        for source in self.sources:
            message = messages.get(SOURCE_TOPICS[source])
            if message is not None:
                with self._counting(message):
                    sources[source] = self._source(decode_detections3d(message, limits=limits))
        if TRACKS_TOPIC in messages and "fused" in sources:
            with self._counting(messages[TRACKS_TOPIC]):
                sources["fused"] = self._with_motion(sources["fused"], messages[TRACKS_TOPIC])
        for camera in self.cameras:
            message = messages.get(_boxes_topic(camera))
            if message is not None:
                with self._counting(message):
                    cameras[camera] = self._boxes(message, limits)
        if DIAGNOSTICS in messages:
            with self._counting(messages[DIAGNOSTICS]):
                values = decode_diagnostics(messages[DIAGNOSTICS], limits=limits).get(SYNCHRONISATION, {})
                skew_ns = _nanoseconds(values.get("skew_ms", ""))
                sync = _sync(messages[DIAGNOSTICS].log_time_ns, values)
        of_frame = [messages[topic] for topic in (*SOURCE_TOPICS.values(), DIAGNOSTICS) if topic in messages]
        first = (of_frame or [*messages.values()])[0]
        return ResultFrame(index, first.stamp_ns, first.log_time_ns, sources, cameras, skew_ns, sync)

    @contextmanager
    def _counting(self, message: RawMessage) -> Iterator[None]:
        """Counts a message that cannot be used, by its error."""
        try:
            yield
        except MessageError as err:
            self._unused.add_note(f"messages of {message.topic} that are not used", str(err))

    def _source(self, found: Detections3D) -> SourceBoxes:
        """The boxes of the configured classes; others are counted, but for those that are of no class by intention."""
        class_ids = np.array([self._class_ids.get(label, UNKNOWN) for label in found.labels.tolist()], np.int32)
        is_known = class_ids != UNKNOWN
        for label in found.labels[~is_known & (found.labels != UNKNOWN_CLASS)].tolist():
            self._unused.add_note(f"3D boxes of class {label!r}, which the settings do not have")
        for reason, count in found.unused.items():
            self._unused.add_note(f"3D boxes that are not used, {reason}", count=count)
        n = len(found)
        boxes = Boxes3D(
            found.stamp_ns,
            found.frame_id,
            found.centers,
            found.sizes,
            found.yaws,
            found.scores,
            class_ids,
            np.zeros(n, np.int32),
            found.covariances,
            np.zeros(n, np.uint8),
            np.full(n, found.stamp_ns, np.int64),
        )
        source = SourceBoxes(boxes, track_ids(found.ids))
        return source if is_known.all() else source.select(is_known)

    def _with_motion(self, source: SourceBoxes, message: RawMessage) -> SourceBoxes:
        """The objects with the motion of the tracks that have their ids; that of the others is not known."""
        found = decode_tracks(message, limits=self.config.limits)
        for reason, count in found.unused.items():
            self._unused.add_note(f"tracks that are not used, {reason}", count=count)
        at, rows = np.nonzero(source.track_ids[:, None] == found.tracks.ids)
        n = len(source)
        velocities, yaw_rates = np.full((n, 2), np.nan), np.full(n, np.nan)
        is_predicted, moving = np.zeros((2, n), np.bool_)
        motions = found.tracks.motions[rows]
        velocities[at], yaw_rates[at] = motions[:, :2], motions[:, 2]
        is_predicted[at], moving[at] = found.is_predicted[rows], found.tracks.moving[rows]
        return replace(source, motion=Motion(velocities, yaw_rates, is_predicted, moving))

    def _boxes(self, message: RawMessage, limits: RecordingLimits) -> Boxes2D:
        found = decode_detections2d(message, ObjectClasses(self._class_ids), limits=limits)
        for reason, count in found.unused.items():
            self._unused.add_note(f"2D boxes that are not used, {reason}", count=count)
        return found.boxes


def open_result(path: Path, settings: Sequence[str] = (), options: ReadOptions = DEFAULT_READ_OPTIONS) -> Result:
    """Open a result, to be used as a context manager.

    `settings` are single ones on top of those that are attached, `["evaluate.iou=[0.5]"]`.

    Raises:
        RecordingError: it cannot be read, or is not a result of lidcam.
        CalibrationError: its rig cannot be used.
        ConfigError: `settings` are wrong.
    """
    metadata, texts = read_records(path)
    config, notes = attached_config(texts[CONFIG], path, metadata.get("version", "unknown"))
    config = load_config(config, settings) if settings else config
    rig = attached_rig(texts[RIG], path, config)
    summary = attached_summary(texts.get(SUMMARY, "{}"), path)
    return Result(path, open_recording([path], options), metadata, config, rig, notes, summary)


@decoder
def decode_diagnostics(
    message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS
) -> Mapping[str, Mapping[str, str]]:
    """The values of each status of a DiagnosticArray by its name; of equal names and keys the last."""
    array = deserialize_as(message, "diagnostic_msgs/msg/DiagnosticArray", limits=limits)
    return {status.name: {pair.key: pair.value for pair in status.values} for status in array.status}


def _boxes_topic(camera: str) -> str:
    return f"/{camera}/detections"


def _sync(log_time_ns: int, values: Mapping[str, str]) -> FrameSync:
    """The messages of a frame by its diagnostics, to the microsecond."""
    named = {key.partition(" ")[::2]: value for key, value in values.items()}
    offsets = {topic: _nanoseconds(value) for (kind, topic), value in named.items() if kind == "offset_ms"}
    return FrameSync(
        log_time_ns,
        {topic: offset_ns for topic, offset_ns in offsets.items() if offset_ns is not None},
        {sensor: why for (kind, sensor), why in named.items() if kind == "missing"},
    )


def _nanoseconds(milliseconds: str) -> int | None:
    try:
        return round(float(milliseconds) * 1e6)
    except (ValueError, OverflowError):
        return None
