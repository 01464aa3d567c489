"""The sections of a page about a result, in the order in which somebody asks: what was seen, can it be trusted, why."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from lidcam.cli.printing.console import BOX_SOURCES
from lidcam.cli.printing.numbers import number, percent
from lidcam.pipeline.core.arrays import Bools
from lidcam.pipeline.core.settings.engines import ENGINES
from lidcam.pipeline.evaluation.road_users import RoadUserTable
from lidcam.run.warning import RunWarning
from lidcam.writers.report import html
from lidcam.writers.report.collector import ReportCollector
from lidcam.writers.report.html import Raw
from lidcam.writers.report.page import class_name

FASTER = 85
"""The speed that 85 % of road users stay below is what roads are designed for."""


def verdict(name: str, seen: ReportCollector, class_names: Sequence[str]) -> Raw:
    """What was seen, in a line and a table."""
    return Raw(
        html.paragraph(_lead(seen, class_names), "lead")
        + html.paragraph(f"{name}: {seen.frames} frames, {_rate(seen)}.", "soft")
        + (users_table(seen.users.table, class_names) if seen.is_tracked else _objects_table(seen, class_names))
    )


def _lead(seen: ReportCollector, class_names: Sequence[str]) -> str:
    duration = _duration(seen.seconds)
    if not any(seen.objects.values()):
        return f"Nothing was found in {duration}."
    if not seen.is_tracked:
        per_frame = sum(seen.objects.values()) / seen.frames
        return f"{per_frame:.1f} objects at a time, in {duration}. They were not tracked, so nobody is counted once."
    counts = np.bincount(seen.users.table.class_ids, minlength=len(class_names)).tolist()
    listed = ", ".join(f"{count} \u00d7 {name}" for count, name in zip(counts, class_names, strict=True) if count)
    total = sum(counts)
    return f"{total} road user{'s' * (total != 1)} in {duration}: {listed}."


def _rate(seen: ReportCollector) -> str:
    if seen.frames < 2 or not seen.seconds:
        return "one moment"
    return f"{(seen.frames - 1) / seen.seconds:.1f} a second"


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes = seconds / 60
    return f"{minutes:.1f} min" if minutes < 120 else f"{minutes / 60:.1f} h"


def users_table(users: RoadUserTable, class_names: Sequence[str]) -> Raw:
    """Road users by class: how many, in which zones, how fast."""
    columns = [*range(1, len(users.places)), 0] if len(users.places) > 1 else []
    head = ["", "number", *(f"in {users.places[c]}" if c else users.places[c] for c in columns), "mean speed"]
    rows = []
    for class_id, name in enumerate(class_names):
        own = users.class_ids == class_id
        if own.any():
            rows.append([class_name(class_id, name), int(own.sum()), *_by_place(users, own, columns)])
            rows[-1] += _speeds(users, own)
    table = html.table([*head, f"{FASTER} % below", "fastest"], rows)
    return table or html.paragraph("No road user was seen.", "soft")


def _by_place(users: RoadUserTable, own: Bools, columns: Iterable[int]) -> list[int]:
    return [int((users.frames[own, column] > 0).sum()) for column in columns]


def _speeds(users: RoadUserTable, own: Bools) -> list[str]:
    means = users.speed_means[own]
    speeds = means.mean(), np.percentile(means, FASTER), users.speed_maxima[own].max()
    return [f"{number(float(speed), 1)} m/s" for speed in speeds]


def _objects_table(seen: ReportCollector, class_names: Sequence[str]) -> Raw:
    rows = [
        [class_name(class_id, name), number(seen.objects[name] / seen.frames, 2)]
        for class_id, name in enumerate(class_names)
        if seen.objects[name]
    ]
    return html.table(["", "objects at a time"], rows)


def doubts(seen: ReportCollector, summary: Mapping[str, Any], warnings: Sequence[RunWarning], version: str) -> Raw:
    """Reasons to doubt the result, each with what to do; or that there are none."""
    lines = [*summary.get("incomplete", ())]
    items = [
        Raw(f"<li><b>{html.text(one.subject)}</b>: {html.text(one.finding)}<span>{html.text(one.remedy)}</span></li>")
        for one in warnings
    ]
    items += [Raw(f"<li><b>not used</b>: {html.text(line)}</li>") for line in lines]
    if not any(seen.objects.values()) and not items:
        items.append(
            Raw(
                "<li><b>no objects</b>: nothing was found, and no check says why<span>look at the combined cloud in a "
                "viewer: are there points where objects stand? <code>lidcam inspect RECORDING --check</code> looks at "
                "poses, <code>lidcam config explain detect3d</code> lists what is too small or too far</span></li>"
            )
        )
    if not summary:
        return html.paragraph(
            f"The result is of lidcam {version}, which kept no summary of what it dropped and warned of. Process the "
            "recording again to have it here.",
            "soft",
        )
    if not items:
        return html.paragraph("Nothing doubtful: all sensors were used, and no check warns.", "sound")
    title = f"{len(items)} thing{'s' * (len(items) != 1)} to look at"
    return Raw(f"<h3>{title}</h3><ul class='doubts'>{''.join(items)}</ul>")


def movements(users: RoadUserTable, class_names: Sequence[str]) -> Raw:
    """Who went from zone to zone."""
    ways = np.stack([users.first_zones, users.last_zones], 1)
    went = ways[:, 0] != ways[:, 1]
    rows = []
    for first, last in np.unique(ways[went], axis=0).tolist():
        own = went & (ways == [first, last]).all(1)
        counts = np.bincount(users.class_ids[own], minlength=len(class_names)).tolist()
        listed = ", ".join(f"{count} \u00d7 {name}" for count, name in zip(counts, class_names, strict=True) if count)
        speed = f"{users.speed_means[own].mean():.1f} m/s"
        rows.append([users.places[first], users.places[last], int(own.sum()), listed, speed])
    rows.sort(key=lambda row: (-row[2], row[0], row[1]))
    return html.table(["from", "to", "number", "of them", "mean speed"], rows, (0, 1, 3))


def dropped(summary: Mapping[str, Any]) -> Raw:
    """What of the recording was not used, and why."""
    drops = [
        [one["topic"], f"{one['count']} {one['unit']}", _reason(one)]
        for one in sorted(summary.get("drops", ()), key=lambda one: (not one["is_defect"], one["topic"]))
    ]
    missing = [
        [one["sensor"], f"{one['frames']} of {one['of_frames']}", _silences(one["silences"])]
        for one in summary.get("missing", ())
        if one["silences"] or one["frames"] == one["of_frames"]
    ]
    losses = [
        [one["file"], "unknown" if one["messages"] is None else one["messages"], one["reason"]]
        for one in summary.get("losses", ())
    ]
    objects = {
        "recorded 2D boxes": "unused_boxes",
        "recorded 3D boxes": "unused_boxes3d",
        "2D boxes without an object": "boxes_without_object",
        "objects not reported": "objects_left_out",
    }
    boxes = [[what, count, why] for what, key in objects.items() for why, count in summary.get(key, {}).items()]
    faults = [[one["sensor"], one["topic"], one["reason"]] for one in summary.get("faults", ())]
    unused = ", ".join(f"{topic} ({count})" for topic, count in summary.get("unused_topics", {}).items())
    tables = {
        "Sensors left out": html.table(["sensor", "topic", "why"], faults, (0, 1, 2)),
        "Frames without a sensor": html.table(["sensor", "frames", "silent"], missing, (0, 2)),
        "Dropped messages": html.table(["topic", "number", "why"], drops, (0, 2)),
        "Boxes and objects": html.table(["", "number", "why"], boxes, (0, 2)),
        "Damaged parts": html.table(["file", "messages lost", "what"], losses, (0, 2)),
        "Topics that were not used": html.paragraph(unused, "soft") if unused else Raw(),
        "Remarks": Raw("".join(html.paragraph(note, "soft") for note in summary.get("notes", ()))),
    }
    return Raw("".join(f"<h3>{title}</h3>{content}" for title, content in tables.items() if content))


def _reason(drop: Mapping[str, Any]) -> Raw:
    fault = "the message is at fault: " if drop["is_defect"] else ""
    example = f"<br><span class='soft'>{html.text(drop['example'])}</span>" if drop["example"] else ""
    return Raw(html.text(fault + drop["reason"]) + example)


def _silences(spans: Sequence[Mapping[str, Any]]) -> str:
    named = [
        f"{0.0 if one['start_s'] is None else one['start_s']:.1f} s to "
        + ("the end" if one["end_s"] is None else f"{one['end_s']:.1f} s")
        for one in spans[:5]
    ]
    return ", ".join(named) + (f" and {len(spans) - 5} times more" if len(spans) > 5 else "")


def origin(
    seen: ReportCollector, summary: Mapping[str, Any], metadata: Mapping[str, str], topics: Mapping[str, str]
) -> Raw:
    """What was recorded and used: files, sensors with their calibration, where boxes and motion come from."""
    files = []
    row = 0
    while (name := metadata.get(f"input.{row}.name", metadata.get(f"input.{row}.url"))) is not None:
        size, digest = metadata.get(f"input.{row}.size"), metadata.get(f"input.{row}.sha256", "")
        told = digest or "none: only a part was processed, or the file changed meanwhile"
        files.append([name, f"{int(size) / 1e6:.1f} MB" if size else "", Raw(f"<code>{html.text(told)}</code>")])
        row += 1
    frames = seen.frames
    used = {topic: int(seen.sensors.sums(topic).sum()) for topic in topics}
    calibration = {one["topic"]: one for one in summary.get("calibration", ())}
    sensors = []
    for topic, sensor in topics.items():
        found = calibration.get(topic, {})
        rate = f"{used[topic] / seen.seconds:.1f} Hz" if seen.seconds else ""
        where = ", ".join(filter(None, (found.get("intrinsics"), found.get("extrinsics"))))
        sensors.append([sensor, topic, rate, percent(used[topic] / frames), where])
    facts = [["2D boxes", BOX_SOURCES.get(summary.get("box_source", ""), "")]]
    if (engine := summary.get("box_source_3d")) in ENGINES:
        facts.append(["3D boxes", ENGINES[engine].words])
    if motion := summary.get("motion"):
        facts.append(["motion of the sensors", _motion(motion, frames)])
    if copied := summary.get("copied"):
        facts.append(["copied from the recording", f"{sum(copied.values())} messages of {len(copied)} topics"])
    return Raw(
        html.table(["recording", "size", "sha256"], files, (0, 2))
        + html.table(["sensor", "topic", "used", "in frames", "calibration from"], sensors, (0, 1, 4))
        + html.table(["", ""], [fact for fact in facts if fact[1]], (0, 1))
    )


def _motion(motion: Mapping[str, Any], frames: int) -> str:
    if motion["topics"]:
        corrected = f", corrected for tracks by the clouds in {n}" if (n := motion["frames_from_clouds"]) else ""
        compensated = f"{motion['compensated_frames']} of {frames} frames compensated"
        return f"from {', '.join(motion['topics'])}; {compensated}{corrected}"
    if motion["frames_from_clouds"]:
        return f"sought in the clouds, for tracks alone, in {motion['frames_from_clouds']} of {frames} frames"
    return "none recorded: they stand still"
