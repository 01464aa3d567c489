"""Data missing from a result: sensors that were silent or are in no frame, and the lines of exit code 3."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from lidcam.pipeline.core.rig import BOXES_SUFFIX, Rig
from lidcam.pipeline.stages.sync.attendance import Absence
from lidcam.readers.recording import Loss
from lidcam.run.warning import RunWarning

MAX_SPANS_NAMED = 3
"""Maximum number of spans of silence named per sensor."""

MIN_SLOWER_SHARE = 1 / 3
"""Minimum share of frames without a sensor that sends fewer messages than there are frames."""

MIN_FRAMES, MIN_MESSAGES = 10, 3
"""Fewest frames of a run, or dropped messages of a sensor, where a sensor is not missing by chance."""


@dataclass(frozen=True, slots=True)
class SilentSpan:
    """A span without messages of one sensor."""

    # When its last message was recorded, in seconds since the start of the recording; None: there was none
    start_s: float | None
    end_s: float | None  # When its next message was recorded; None: none came
    frames: int  # Number of frames in the span

    def __str__(self) -> str:
        if self.start_s is None and self.end_s is None:
            return "silent throughout"
        if self.start_s is None:
            return f"silent until {self.end_s:.1f} s"
        return f"silent from {self.start_s:.1f} s to {'the end' if self.end_s is None else f'{self.end_s:.1f} s'}"


@dataclass(frozen=True, slots=True)
class MissingSensor:
    """A sensor that is missing from frames.

    Attributes:
        sensor: Its name, or that of its boxes.
        topic: Its topic.
        frames: Number of frames without it.
        of_frames: Number of all frames.
        silences: Spans in which it sent nothing; `frames` includes theirs.
        is_apart: Whether all of its frames lack the lidars, or the other ones, and all sensors that these share frames
            with: it is of another time.
    """

    sensor: str
    topic: str
    frames: int
    of_frames: int
    silences: tuple[SilentSpan, ...]
    is_apart: bool = False

    @property
    def alive_frames(self) -> int:
        """Number of frames without it while it sent messages."""
        return self.frames - sum(span.frames for span in self.silences)

    @property
    def is_slower(self) -> bool:
        """Whether it seems to send fewer messages than there are frames, provided that all of them are in frames."""
        return not self.silences and MIN_SLOWER_SHARE <= self.frames / self.of_frames < 1

    @property
    def spans(self) -> str:
        """The spans of silence, in words; empty without any."""
        more = len(self.silences) - MAX_SPANS_NAMED
        named = ", ".join(map(str, self.silences[:MAX_SPANS_NAMED]))
        return f"{named} and {more} times more" if more > 0 else named

    def __str__(self) -> str:
        single = f"in {self.alive_frames} of {self.of_frames} frames" if self.alive_frames else ""
        return "; ".join(filter(None, (self.spans, single)))


def missing_sensors(
    absences: Sequence[Absence], rig: Rig, groups: Iterable[set[str]] = (), *, of_frames: int, start_ns: int
) -> list[MissingSensor]:
    """Missing sensors from absences in `of_frames` frames; `start_ns` is the log time of the start of the recording.

    `groups` are the topics that share frames; those beside most lidars, else the most, are together.
    """
    topics = [*rig.sensor_of_topic]
    geometric = {one.topic for one in rig.lidars} | {one.topic for one in rig.detectors}
    ordered = sorted(groups, key=lambda group: min(map(topics.index, group)))
    usual = max(ordered, key=lambda group: (len(group & geometric), len(group)), default=set[str]())
    apart = set[str]().union(*ordered) - usual

    def seconds(log_time_ns: int | None) -> float | None:
        return None if log_time_ns is None else (log_time_ns - start_ns) / 1e9

    return [
        MissingSensor(
            rig.sensor_of_topic[absence.topic],
            absence.topic,
            absence.frames,
            of_frames,
            tuple(SilentSpan(seconds(s.start_ns), seconds(s.end_ns), s.frames) for s in absence.silences),
            absence.topic in apart,
        )
        for absence in absences
    ]


def silence_warnings(missing: Sequence[MissingSensor]) -> list[RunWarning]:
    """One warning for all sensors that were silent at the same time; recorded boxes are silent with their camera."""
    silent = {sensor.sensor for sensor in missing if sensor.silences}
    by_finding: dict[str, list[MissingSensor]] = {}
    for sensor in missing:
        if sensor.sensor in silent and sensor.sensor.removesuffix(BOXES_SUFFIX) not in silent - {sensor.sensor}:
            frames = sum(span.frames for span in sensor.silences)
            finding = f"{sensor.spans}; {frames} of {sensor.of_frames} frames lack"
            by_finding.setdefault(finding, []).append(sensor)
    return [_silence_warning(finding, sensors) for finding, sensors in by_finding.items()]


def _silence_warning(finding: str, sensors: Sequence[MissingSensor]) -> RunWarning:
    names, topics = (", ".join(of) for of in zip(*((one.sensor, one.topic) for one in sensors), strict=True))
    if any(span.start_s is None and span.end_s is None for span in sensors[0].silences):  # yet its topic has messages
        remedy = f"the messages of {topics} lie at other times: choose --start and --duration, or check the clocks"
    elif len(sensors) == 1:
        remedy = f"check the sensor, its driver and the recording of {topics}"
    else:
        remedy = "check what they share: power, network, driver, or the recorder"
    return RunWarning(names, f"{finding} {'it' if len(sensors) == 1 else 'them'}", remedy)


def absent_sensors(missing: Sequence[MissingSensor], dropped: Mapping[str, int]) -> list[MissingSensor]:
    """Sensors that sent messages but are in no frame of several, or in none with the others.

    A camera's boxes are listed only without it. Dropped messages by topic: those of a short recording count, too.
    """
    never_used = [sensor for sensor in missing if sensor.alive_frames and sensor.frames == sensor.of_frames]
    absent = never_used + [sensor for sensor in missing if sensor.is_apart]
    cameras = {f"{sensor.sensor}{BOXES_SUFFIX}" for sensor in absent}
    return [
        sensor
        for sensor in absent
        if (
            sensor.of_frames >= MIN_FRAMES
            or max(dropped.get(sensor.topic, 0), sensor.of_frames - sensor.frames) >= MIN_MESSAGES
        )
        and sensor.sensor not in cameras
    ]


def absence_warnings(missing: Sequence[MissingSensor], dropped: Mapping[str, int]) -> list[RunWarning]:
    """One warning for each sensor that sent messages but is in no frame; `dropped` as of `absent_sensors`."""
    return [
        RunWarning(
            sensor.sensor,
            f"is in none of the {sensor.of_frames} frames, though it was recorded",
            "compare its stamps with those of the others, and see sync.slop_s and sync.max_interval_s",
        )
        for sensor in absent_sensors(missing, dropped)
        if not sensor.is_apart
    ]


def apart_warnings(missing: Sequence[MissingSensor]) -> list[RunWarning]:
    """One warning for each sensor that is in no frame with the others."""
    return [
        RunWarning(
            sensor.sensor,
            f"is in no frame with the other sensors: {sensor.spans or 'it was recorded at another time'}",
            "if it was there with them, the clock of the computer that recorded it is off: record all by one clock",
        )
        for sensor in absent_sensors(missing, {})
        if sensor.is_apart
    ]


def absent_lines(missing: Sequence[MissingSensor], dropped: Mapping[str, int]) -> list[str]:
    """One line for each sensor that was recorded and is in no frame; `dropped` as of `absent_sensors`."""
    return [
        f"{one.sensor} is in {'no frame with the others' if one.is_apart else f'none of the {one.of_frames} frames'}"
        for one in absent_sensors(missing, dropped)
    ]


def changed_lines(paths: Iterable[str]) -> list[str]:
    """One line for each file that changed while it was read: the result may be of a mixture."""
    return [f"{path}: changed while it was read; run it again when nothing writes to it" for path in paths]


def damage_lines(losses: Sequence[Loss]) -> list[str]:
    """One line for each file with lost messages; a file that was only not closed has none."""
    of_file: defaultdict[str, list[int | None]] = defaultdict(list)
    for loss in losses:
        if loss.messages != 0:
            of_file[str(loss.path)].append(loss.messages)
    return [f"{path}: {_damage(counts)}" for path, counts in sorted(of_file.items())]


def _damage(counts: Sequence[int | None]) -> str:
    known = [count for count in counts if count is not None]
    messages = f"{sum(known)} message{'s' * (sum(known) != 1)}"
    if len(known) == len(counts):
        return f"damaged, {messages} lost"
    return f"damaged, {messages} or more lost" if known else "damaged, an unknown number of messages lost"
