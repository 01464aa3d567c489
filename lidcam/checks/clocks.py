"""Notes and warnings about the clocks of sensors and recorder: they jump, are off, or are not read at all."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.text import listed
from lidcam.pipeline.stages.sync.clocks import Clocks, TimeJump
from lidcam.pipeline.stages.sync.drop_reason import DropReason
from lidcam.pipeline.stages.sync.synchronize import SyncStats
from lidcam.run.frames import RunInput
from lidcam.run.missing import MissingSensor, absence_warnings, apart_warnings, silence_warnings
from lidcam.run.summary import DropCount, dropped_by_topic
from lidcam.run.warning import RunWarning

MAX_JUMPS_NAMED = 5
"""Maximum number of jumps with their own warning."""

ALIKE_NS = 1_000_000_000
"""Steps in which the jumps of the sensors of one computer are equal, nanoseconds."""

MAX_SENSORS_NAMED = 10
"""Maximum number of sensors named in one note."""

MIN_LATE_SHARE = 0.1
"""Minimum share of late messages of a sensor that is named; single ones are late at start-up or on a busy recorder."""

MIN_STALLED, MIN_STALLED_SHARE = 5, 0.7
"""Minimum number and share of stamps that hardly advance of a topic that is named."""

WITHOUT_PARTNER = DropReason.LEFT_OUT, DropReason.TOO_FAR
"""Drop reasons of sweeps for which another lidar has no sweep."""

MIN_WITHOUT_PARTNER, MIN_WITHOUT_PARTNER_SHARE = 3, 0.3
"""Minimum number of such sweeps, and their minimum share, of a lidar that is named."""


def sync_warnings(
    clocks: Clocks, stats: SyncStats, missing: Sequence[MissingSensor], drops: Sequence[DropCount], source: RunInput
) -> Iterator[RunWarning]:
    """Findings in the stamps of sensors, in a run as in an inspection: jumps, silence, reasons for absence."""
    yield from jump_warnings(clocks.jumps, source.rig.sensor_of_topic, start_ns=source.recording.start_ns)
    yield from stalled_warnings(clocks.stalled, source.rig)
    yield from apart_warnings(missing) or silence_warnings(missing)
    counts = {(drop.topic, drop.reason): drop.count for drop in drops}
    known = {jump.topic for jump in clocks.jumps}
    late = late_warnings({of: count for of, count in counts.items() if of[0] not in known}, stats.received, source.rig)
    yield from (late or absence_warnings(missing, dropped_by_topic(drops)))
    yield from slower_warnings(counts, stats.received, source.rig)


def jump_warnings(jumps: Sequence[TimeJump], sensors: Mapping[str, str], *, start_ns: int) -> Iterator[RunWarning]:
    """One for each of the first jumps of time, those of the sensors of one computer together.

    `sensors` names sensors by topic; `start_ns` is the log time at which the recording starts.
    """
    alike = [[*group] for _, group in groupby(jumps, _event)]
    for group in alike[:MAX_JUMPS_NAMED]:
        topics = dict.fromkeys(sensors.get(jump.topic, jump.topic) for jump in group)
        yield _jump_warning(group[0], listed([*topics], MAX_SENSORS_NAMED), start_ns)
    if (more := len(alike) - MAX_JUMPS_NAMED) > 0:
        remedy = "look at the clocks of the sensors with `lidcam inspect`"
        yield RunWarning("time", f"jumps {more} times more", remedy)


def clock_notes(clocks: Clocks, sensors: Mapping[str, str]) -> list[str]:
    """Notes about sensors without stamps; `sensors` names them by topic."""
    names = [sensors.get(topic, topic) for topic in clocks.unstamped]
    if not names:
        return []
    some = listed(names, MAX_SENSORS_NAMED)
    return [f"{some}: all stamps are 0, so the times at which the messages were recorded are used"]


def stalled_warnings(stalled: Mapping[str, tuple[int, int]], rig: Rig) -> Iterator[RunWarning]:
    """One for each topic most of whose stamps hardly advance: set once, in whole seconds or in another unit.

    Parts of a sweep may have one stamp.
    """
    for topic, (count, steps) in stalled.items():
        if count >= max(MIN_STALLED, MIN_STALLED_SHARE * steps):
            finding = f"{count} of {steps + 1} stamps hardly advance on the one before"
            remedy = "frames and speeds cannot be right: correct the stamps, or set all to 0 to use log times"
            yield RunWarning(rig.sensor_of_topic.get(topic, topic), finding, remedy)


def late_warnings(drops: Mapping[tuple[str, str], int], received: Mapping[str, int], rig: Rig) -> list[RunWarning]:
    """One for each sensor of which many messages are late: dropped by topic and reason, received by topic."""
    names = rig.sensor_of_topic
    return [
        RunWarning(
            names[topic],
            f"{count} of {received[topic]} messages came after their frames were complete",
            "a larger sync.queue_size waits longer; if its clock is off, give its time_offset_ms in the rig file",
        )
        for (topic, reason), count in drops.items()
        if reason == DropReason.TOO_LATE and count >= MIN_LATE_SHARE * received[topic]
    ]


def slower_warnings(
    drops: Mapping[tuple[str, str], int], received: Mapping[str, int], rig: Rig
) -> Iterator[RunWarning]:
    """One for each lidar that loses many sweeps because another one, which is required, is slower."""
    for lidar in rig.lidars if len(rig.lidars) > 1 else ():
        count, of = sum(drops.get((lidar.topic, reason), 0) for reason in WITHOUT_PARTNER), received.get(lidar.topic, 0)
        if count >= max(MIN_WITHOUT_PARTNER, MIN_WITHOUT_PARTNER_SHARE * of):
            finding = f"{count} of {of} sweeps make no frame: no sweep of another lidar is near them in time"
            yield RunWarning(lidar.name, finding, f"--set 'sync.required=[{lidar.topic}]' makes a frame of each")


def _event(jump: TimeJump) -> tuple[str, int]:
    """The kind of a jump, and its size or place: equal for jumps that are told together."""
    return jump.kind, round(jump.by_ns / ALIKE_NS) if jump.topic else jump.at_ns


def _jump_warning(jump: TimeJump, sensors: str, start_ns: int) -> RunWarning:
    at_s, side = (jump.at_ns - start_ns) / 1e9, "back" if jump.by_ns > 0 else "ahead"
    jumps = f"jump {side} by {abs(jump.by_ns) / 1e9:.1f} s at {at_s:.1f} s"
    if jump.kind == "log times":
        finding = f"log times {jumps}: the parts before and after are processed one after the other"
        return RunWarning("time", finding, "if these are two recordings, write them to two files")
    set_before = "wait until clocks are set (NTP, PTP) before you record"
    if jump.kind == "moved":
        return RunWarning(sensors, f"stamps {jumps}; they are moved to the others', right to about 0.1 s", set_before)
    seconds = f"{max(jump.at_ns - start_ns, 0) // 10**7 / 100:g}"
    after = f"--start {seconds} leaves out what was before"
    if jump.kind == "set":
        finding = f"stamps {jumps} and agree with the others' from there on: a clock was set, or it was recorded late"
        return RunWarning(sensors, finding, after)
    finding = f"stamps {jumps}: no frame has messages of both sides"
    loop = f"if it was played in a loop, process one pass of it with --duration {seconds}, or --start {seconds}"
    return RunWarning("time", finding, loop if jump.by_ns > 0 else f"{set_before}; {after}")
