"""Printing of a run: a dozen lines on who moved and who stood, and all tables behind `--verbose`."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple

from rich.console import Console

from lidcam.cli.printing.console import (
    NO_MOTION,
    below_one_name,
    print_losses,
    print_remarks,
    print_warnings,
    source_of_boxes3d,
)
from lidcam.cli.printing.numbers import PER_M_S, Units
from lidcam.cli.printing.tables import (
    ColumnsTable,
    drops_table,
    missing_table,
    objects_table,
    pairs_table,
    road_users_table,
    rows_table,
    speed_text,
)
from lidcam.cli.printing.terminal import show_line, show_table
from lidcam.pipeline.core.settings.engines import ENGINES
from lidcam.pipeline.core.text import listed
from lidcam.run.summary import CameraCorrection, DropCount, RunSummary, dropped_by_topic

MAX_ZONES = 3
"""Maximum number of zones with a column of their own."""

MAX_LINES = 3
"""Maximum number of warnings, and of topics with drops, that the short summary prints."""

MAX_NAMED = 2
"""Maximum number of topics that it names as missing from the same number of frames; more are counted."""

GEOMETRY = {"lidar": "lidar only", "camera": "camera only", "both": "both", "predicted": "predicted by tracks"}


def print_summary(out: Console, summary: RunSummary, units: Units = "km/h") -> None:
    """Print who moved and who stood, what is amiss, the files, and how to look at them."""
    frames, sensors, timing = summary.frames, summary.sensors, summary.timing
    if sensors.box_words[1]:
        show_line(out, sensors.box_words[1], "bold yellow")
    rate = (
        f" in {timing.wall_seconds:.1f} s, {timing.frames_per_second:.1f} per second" if timing.wall_seconds > 0 else ""
    )
    devices = [(len(sensors.rig.lidars), "lidar"), (len(sensors.rig.cameras), "camera")]
    parts = [f"{_plural(frames.count, 'frame')}{rate}", ", ".join(_plural(*one) for one in devices if one[0])]
    show_line(out, "; ".join(filter(None, [*parts, f"settings: {summary.settings.name}"])), "bold")
    words_3d, words_2d = ENGINES[sensors.box_source_3d].words, sensors.box_words[0].partition(";")[0]
    show_line(out, f"3D boxes: {words_3d}; 2D boxes: {words_2d}")
    _print_road_users(out, summary, units)
    for line in (_found(summary), _corrected(sensors.corrections), *_missing(summary)):
        if line:
            show_line(out, line)
    for line in _first([f"note: {note}" for note in summary.notes], "more notes, with -v"):
        show_line(out, line)
    for line in _first([f"warning: {warning}" for warning in summary.warnings], "more warnings, with -v"):
        show_line(out, line, "yellow")
    if files := (*summary.outputs, *summary.sent):
        show_line(out, f"wrote {_named(files)}")
    if look := _look(summary):
        show_line(out, f"to look at it: {look}", "bold")


def _print_road_users(out: Console, summary: RunSummary, units: Units) -> None:
    """The table of road users by class; without tracks, objects per frame."""
    users, frames = summary.road_users, summary.frames
    zones = [zone.name for zone in summary.sensors.rig.counted_zones][:MAX_ZONES]
    if users is None:
        names = sorted({name for name, _ in frames.objects})
        counts = [sum(count for (known, _), count in frames.objects.items() if known == name) for name in names]
        means = [f"{name} {count / max(frames.count, 1):.1f}" for name, count in zip(names, counts, strict=True)]
        show_line(out, f"objects per frame: {', '.join(means) or 'none'}")
        return
    whole = [one for one in users.counts if not one.zone]
    if not whole:
        show_line(out, "no road users")
        return
    is_brief = any(one.moved + one.stood < one.count for one in whole)
    speeds = f"mean {units}", f"max {units}"
    table = ColumnsTable("", "road users", "moved", "stood", *["brief"] * is_brief, *speeds, *zones)
    factor = PER_M_S[units]
    for one in whole:
        here = {count.zone: count.count for count in users.counts if count.class_name == one.class_name}
        table.add_row(
            one.class_name,
            *map(str, (one.moved, one.stood, *[one.count - one.moved - one.stood] * is_brief)),
            *(speed_text(factor * speed) for speed in (one.speed_mean_m_s, one.speed_max_m_s)),
            *(str(here.get(zone, 0)) for zone in zones),
        )
    show_table(out, table)


def _found(summary: RunSummary) -> str:
    """The objects that cameras confirm, and those that tracks predict; empty without objects."""
    total, predicted = sum(summary.frames.objects.values()), summary.frames.sources.get("predicted", 0)
    if not total:
        return ""
    parts = [f"{summary.frames.confirmed} confirmed by a camera"] * (summary.sensors.box_source != "none")
    parts += [f"{predicted} predicted by tracks"] * bool(predicted)
    return f"{_plural(total, 'object')} in all frames{': ' if parts else ''}{', '.join(parts)}"


def _missing(summary: RunSummary) -> Iterator[str]:
    """Messages that were dropped, by reason, and sensors that are missing from frames."""
    reasons: dict[str, list[DropCount]] = {}
    for drop in summary.drops.messages:
        if drop.unit == "messages":
            reasons.setdefault(drop.reason, []).append(drop)
    lines = []
    for reason, drops in reasons.items():
        count, (first, *others) = sum(drop.count for drop in drops), drops
        where = f"{len(drops)} topics" if others else first.topic
        lines.append(f"dropped: {_plural(count, 'message')} of {where}: {reason}")
    yield from _first(lines, "more reasons, with -v")
    dropped, frames = dropped_by_topic(summary.drops.messages), summary.frames.count
    slower = [one for one in summary.sensors.missing if one.is_slower and not dropped[one.topic]]
    missing = [one for one in summary.sensors.missing if one not in slower]
    yield from _sensors_line("slower sensors", [(frames - one.frames, one.sensor) for one in slower], frames)
    yield from _sensors_line("missing", [(one.frames, one.sensor) for one in missing], frames)


def _sensors_line(what: str, counted: list[tuple[int, str]], frames: int) -> Iterator[str]:
    """A line of sensors by their number of frames, if there are any."""
    parts = []
    for count in sorted({count for count, _ in counted}):
        names = [name for its, name in counted if its == count]
        parts.append(f"{' and '.join(names) if len(names) <= MAX_NAMED else f'{len(names)} topics'} in {count}")
    if parts:
        yield f"{what}: {listed(parts)} of {_plural(frames, 'frame')}; -v says when"


def _first(lines: list[str], more: str) -> list[str]:
    """The first lines and the last, which may say what to do, and how many more there are."""
    left = len(lines) - MAX_LINES  # a line that tells of one more would take its place
    return lines if left <= 0 else [*lines[: MAX_LINES - 1], f"and {left} {more}", lines[-1]]


def _named(files: Sequence[object]) -> str:
    """Files in a line: those that have the name of the first but for its ending, by their endings."""
    first, *others = map(str, files)
    stem = first.rpartition(".")[0]
    return ", ".join([first, *(name.removeprefix(stem) if name.startswith(f"{stem}.") else name for name in others)])


def _look(summary: RunSummary) -> str:
    """The command that opens the outputs; empty where none can be opened."""
    found = {path.suffix: path for path in summary.outputs}
    shown = [found[ending] for ending in (".rrd", ".html", ".mcap", ".mp4") if ending in found]
    if not shown:
        return ""
    first, _, others = _named(shown).partition(", ")
    return f"lidcam view {shlex.quote(first)}{f' (or {others})' if others else ''}"


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def print_details(out: Console, summary: RunSummary) -> None:
    """All tables of a run: road users by zone, objects, messages, damage, times, points, settings, remarks."""
    inputs, frames, drops = summary.inputs, summary.frames, summary.drops
    sensors, timing = summary.sensors, summary.timing
    zones = [zone.name for zone in sensors.rig.counted_zones]
    count = max(frames.count, 1)
    if users := summary.road_users:
        show_table(out, road_users_table(users, zones))
        out.print()
        if users.changes:
            columns = ("class", "from", "to", "number", "mean m/s")
            changes = ((*astuple(one)[:4], speed_text(one.speed_mean_m_s)) for one in users.changes)
            show_table(out, rows_table("road users from zone to zone", columns, changes, columns[:3]))
            out.print()
    show_line(out, f"objects, sum over {_plural(frames.count, 'frame')}", "bold")
    show_table(out, objects_table(frames.objects, zones, frames.count))
    _print_counts(out, "detections dropped", drops.objects)
    out.print()
    show_table(out, drops_table(inputs.messages_used, drops.messages))
    for drop in drops.messages:
        if drop.example:
            show_line(out, f"  {drop.reason}: {drop.example}", "dim")
    _print_counts(out, "recorded 2D boxes not used", drops.boxes)
    _print_counts(out, "recorded 3D boxes not used", drops.boxes3d)
    _print_counts(out, "unmatched 2D boxes", drops.boxes_without_object)
    if sensors.missing:
        out.print()
        show_table(out, missing_table(sensors.missing))
    print_losses(out, inputs.losses)
    milliseconds = {name: f"{1e3 * seconds / count:.1f}" for name, seconds in timing.stage_seconds.items()}
    if milliseconds:
        out.print()
        rows = [row for row in milliseconds.items() if row[1] != "0.0"]
        show_table(out, rows_table("time", ("stage", "ms per frame"), rows))
    out.print()
    points = ((step, f"{total / count:.0f}") for step, total in frames.points.items())
    show_table(out, rows_table("points", ("step", "points per frame"), points))
    out.print()
    rate = f", {timing.frames_per_second:.1f} per second" if timing.frames_per_second >= 0 else ""
    copied = f"{sum(inputs.copied.values())} messages: {below_one_name(inputs.copied)}" if inputs.copied else ""
    facts = {
        "frames": f"{frames.count}{rate}",
        "sync skew": f"mean {frames.skew_mean_ms:.1f} ms, max {frames.skew_max_ms:.1f} ms",
        "motion": _motion(summary),
        "3D boxes": _boxes3d(summary),
        "2D boxes": sensors.box_words[0],
        **({"cameras": corrected} if (corrected := _corrected(sensors.corrections)) else {}),
        "confirmed": _confirmed(summary),
        "geometry": ", ".join(f"{GEOMETRY[name]} {n}" for name, n in frames.sources.items()),
        **({"copied": copied} if copied else {}),
        "settings": str(summary.settings),
        "written": ", ".join(map(str, (*summary.outputs, *summary.sent))),
        **summary.how_to_open,
    }
    show_table(out, pairs_table("run", facts))
    print_remarks(out, sensors.faults, summary.notes)
    if unused := inputs.unused_topics:
        names = [
            f"{topic.topic} ({topic.message_count}: {topic.problem})" if topic.problem else topic.topic
            for topic in unused
        ]
        show_line(out, f"not used: {listed(names)}")
    print_warnings(out, summary.warnings)


def _corrected(corrections: Mapping[str, CameraCorrection]) -> str:
    return "; ".join(
        f"{name} turned by {one.turned_deg:.2f} ± {one.turned_sigma_deg:.2f} degrees, images {abs(one.late_ms):.0f} ± "
        f"{one.late_sigma_ms:.0f} ms {'late' if one.late_ms >= 0 else 'early'}"
        f"{f', focal length times {one.zoom:g}' if one.zoom != 1 else ''}: corrected"
        for name, one in corrections.items()
    )


def _print_counts(out: Console, what: str, counts: Mapping[str, int]) -> None:
    for reason, count in counts.items():
        show_line(out, f"  {count} {what}: {reason}")


def _motion(summary: RunSummary) -> str:
    frames, topics = summary.frames, summary.sensors.motion_topics
    if topics:
        lost = f"; {n} could not be registered" if (n := frames.odometry_predicted) else ""
        corrected = f"; for tracks, corrected from the clouds (small_gicp){lost}" if frames.odometry else ""
        return f"{frames.compensated} of {frames.count} frames compensated, from {', '.join(topics)}{corrected}"
    if not frames.odometry:
        return NO_MOTION
    found = f"for tracks only, from the clouds (small_gicp), {frames.odometry} of {frames.count} frames"
    if not frames.odometry_predicted:
        return found
    return f"{found}; {frames.odometry_predicted} could not be registered and keep the last velocity"


def _boxes3d(summary: RunSummary) -> str:
    source = source_of_boxes3d(summary.sensors.box_source_3d, summary.sensors.rig)
    missing = summary.frames.without_boxes3d
    return f"{source}; {missing} of {summary.frames.count} frames have none" if missing else source


def _confirmed(summary: RunSummary) -> str:
    confirmed = f"{summary.frames.confirmed} of {sum(summary.frames.objects.values())} objects by a camera"
    if summary.sensors.box_source == "none" or not summary.frames.without_boxes:
        return confirmed
    return f"{confirmed}; {summary.frames.without_boxes} of {summary.frames.count} frames have no 2D boxes"
