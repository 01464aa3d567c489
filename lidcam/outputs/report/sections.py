"""The content of a page about a result, in the order in which somebody asks: what was seen, can it be trusted, why."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from lidcam.cli.printing.numbers import PER_M_S, number, percent
from lidcam.pipeline.core.settings.engines import ENGINES
from lidcam.pipeline.core.text import visible
from lidcam.pipeline.core.tracks import MIN_MOVING_SPEED_M_S
from lidcam.pipeline.evaluation.road_users import RoadUserTable
from lidcam.readers.input_file import recorded_inputs
from lidcam.readers.results.result import Result
from lidcam.run.box_sources import boxes_2d_words
from lidcam.run.warning import RunWarning
from lidcam.writers.report.collector import ReportCollector
from lidcam.writers.report.page import PageTable, class_name

FASTER = 85
"""Percentile of the mean speeds that roads are designed for."""

MAX_SILENCES = 5
"""Spans that are listed of a silent sensor."""

NOTHING_FOUND = Markup(
    "look at the combined cloud in a viewer: are there points where objects stand? <code>lidcam inspect RECORDING "
    "--check</code> looks at poses, <code>lidcam config explain detect3d</code> lists what is too small or too far"
)


def code(text: str) -> Markup:
    """A text in the font of code."""
    return Markup("<code>{}</code>").format(visible(text))


def lead(seen: ReportCollector, class_names: Sequence[str]) -> str:
    """A line about what was seen."""
    factor, unit = (1, "s") if seen.seconds < 120 else (60, "min") if seen.seconds < 7200 else (3600, "h")
    duration = f"{seen.seconds / factor:.1f} {unit}"
    if not any(seen.objects.values()):
        return f"Nothing was found in {duration}."
    if not seen.is_tracked:
        per_frame = sum(seen.objects.values()) / seen.frames
        return f"{per_frame:.1f} objects at a time, in {duration}. They were not tracked, so nobody is counted once."
    users = seen.users.table
    moved, stood = int(users.moved.sum()), int(users.stood.sum())
    counted = {"moved": moved, "stood": stood, "seen too briefly to tell": len(users) - moved - stood}
    did = ", ".join(f"{count} {what}" for what, count in counted.items() if count)
    who = f"{len(users)} road user{'s' * (len(users) != 1)} in {duration}"
    return f"{who}: {_listed(users.class_ids, class_names)}." + (f" {did}." if did else "")


def busiest_note(seen: ReportCollector) -> str:
    """The caption of the first image; empty without one."""
    if (found := seen.busiest) is None:
        return ""
    objects = f"{len(found.boxes)} object{'s' * (len(found.boxes) != 1)}"
    return f"The busiest moment, {found.time_s:.1f} s after the first frame: {objects}."


def _listed(class_ids: Any, class_names: Sequence[str]) -> str:
    counts = np.bincount(class_ids, minlength=len(class_names)).tolist()
    return ", ".join(f"{count} \u00d7 {name}" for count, name in zip(counts, class_names, strict=True) if count)


def frame_rate(seen: ReportCollector) -> str:
    """Frames a second."""
    is_span = seen.frames > 1 and seen.seconds
    return f"{(seen.frames - 1) / seen.seconds:.1f} a second" if is_span else "one moment"


def counts(seen: ReportCollector, class_names: Sequence[str]) -> PageTable:
    """Road users by class, with zones, and speeds of those that moved; objects at a time where nothing was tracked."""
    rows: list[list[object]]
    if not seen.is_tracked:
        rows = [
            [class_name(class_id, name), number(seen.objects[name] / seen.frames, 2)]
            for class_id, name in enumerate(class_names)
            if seen.objects[name]
        ]
        return PageTable(["", "objects at a time"], rows)
    users = seen.users.table
    columns = [*range(1, len(users.places)), 0] if len(users.places) > 1 else []
    places = [f"in {users.places[column]}" if column else users.places[column] for column in columns]
    rows, is_brief = [], not (users.moved | users.stood).all()
    for class_id, name in enumerate(class_names):
        own = users.class_ids == class_id
        if own.any():
            moved, stood = own & users.moved, own & users.stood
            counts = [int(which.sum()) for which in (own, moved, stood, *[own & ~moved & ~stood] * is_brief)]
            means, maxima = users.speed_means[moved], users.speed_maxima[moved]
            speeds = (means.mean(), np.percentile(means, FASTER), maxima.max()) if len(means) else ()
            by_place = [int((users.frames[own, column] > 0).sum()) for column in columns]
            shown = [speed_text(float(speed)) for speed in speeds] or [""] * 3
            rows.append([class_name(class_id, name), *counts, *by_place, *shown])
    least = speed_text(MIN_MOVING_SPEED_M_S)
    notes = [f"Speeds in km/h (m/s), of those that moved: {least} or more, beyond the uncertainty."]
    counted = ["number", "moved", "stood", *["brief"] * is_brief]
    head = ["", *counted, *places, "mean speed", f"{FASTER} % below", "fastest"]
    return PageTable(head, rows, notes=notes if rows else ())


def speed_text(speed_m_s: float) -> str:
    """A speed in km/h, and in m/s."""
    return f"{number(speed_m_s * PER_M_S['km/h'], 1)} ({number(speed_m_s, 1)})"


def doubts(
    seen: ReportCollector, summary: Mapping[str, Any], warnings: Iterable[RunWarning]
) -> list[tuple[str, str, str]]:
    """Reasons to doubt the result: subject, finding, and what to do."""
    found = [(one.subject, one.finding, one.remedy) for one in warnings]
    found += [("not used", line, "") for line in summary.get("incomplete", ())]
    if not any(seen.objects.values()) and not found:
        found.append(("no objects", "nothing was found, and no check says why", NOTHING_FOUND))
    return found


def movements(users: RoadUserTable, class_names: Sequence[str]) -> PageTable:
    """Who went from zone to zone."""
    ways = np.stack([users.first_zones, users.last_zones], 1)
    went = ways[:, 0] != ways[:, 1]
    rows: list[list[Any]] = []
    for first, last in np.unique(ways[went], axis=0).tolist():
        own = went & (ways == [first, last]).all(1)
        means = users.speed_means[own & users.moved]
        speed = speed_text(float(means.mean())) if len(means) else ""
        listed = _listed(users.class_ids[own], class_names)
        rows.append([users.places[first], users.places[last], int(own.sum()), listed, speed])
    rows.sort(key=lambda row: (-row[2], row[0], row[1]))
    return PageTable(["from", "to", "number", "of them", "mean km/h (m/s)"], rows, (0, 1, 3))


def dropped(summary: Mapping[str, Any]) -> list[PageTable]:
    """Parts of the recording that were not used, with the reasons; messages at fault first."""
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
    return [
        PageTable(["sensor", "topic", "why"], faults, (0, 1, 2), "Sensors left out"),
        PageTable(["sensor", "frames", "silent"], missing, (0, 2), "Frames without a sensor"),
        PageTable(["topic", "number", "why"], drops, (0, 2), "Dropped messages"),
        PageTable(["", "number", "why"], boxes, (0, 2), "Boxes and objects"),
        PageTable(["file", "messages lost", "what"], losses, (0, 2), "Damaged parts"),
        PageTable([], [], title="Topics that were not used", notes=[unused] if unused else []),
        PageTable([], [], title="Remarks", notes=summary.get("notes", ())),
    ]


def _reason(drop: Mapping[str, Any]) -> Markup:
    reason = ("the message is at fault: " if drop["is_defect"] else "") + drop["reason"]
    example = Markup('<br><span class="soft">{}</span>').format(visible(drop["example"])) if drop["example"] else ""
    return Markup("{}{}").format(visible(reason), example)


def _silences(spans: Sequence[Mapping[str, Any]]) -> str:
    named = [
        f"{0.0 if one['start_s'] is None else one['start_s']:.1f} s to "
        + ("the end" if one["end_s"] is None else f"{one['end_s']:.1f} s")
        for one in spans[:MAX_SILENCES]
    ]
    more = len(spans) - MAX_SILENCES
    return ", ".join(named) + (f" and {more} times more" if more > 0 else "")


def origin(seen: ReportCollector, result: Result) -> list[PageTable]:
    """Files, sensors with their calibration, and the sources of boxes and motion."""
    summary, metadata, topics = result.summary, result.metadata, result.rig.sensor_of_topic
    files = [
        [one.get("name", ""), f"{int(one['size']) / 1e6:.1f} MB" if one.get("size") else ""]
        for one in recorded_inputs(metadata)
    ]
    used = {topic: int(seen.sensors.sums(topic).sum()) for topic in topics}
    calibration = {one["topic"]: one for one in summary.get("calibration", ())}
    sensors = []
    for topic, sensor in topics.items():
        found = calibration.get(topic, {})
        rate = f"{(seen.frames - 1) / seen.seconds * used[topic] / seen.frames:.1f} Hz" if seen.seconds else ""
        where = ", ".join(filter(None, (found.get("intrinsics"), found.get("extrinsics"))))
        sensors.append([sensor, topic, rate, percent(used[topic] / seen.frames), where])
    facts = [["2D boxes", boxes_2d_words(result.config, result.rig)[0].partition(";")[0]]]
    if (engine := summary.get("box_source_3d")) in ENGINES:
        facts.append(["3D boxes", ENGINES[engine].words])
    if motion := summary.get("motion"):
        facts.append(["motion of the sensors", _motion(motion, seen.frames)])
    if copied := summary.get("copied"):
        facts.append(["copied from the recording", f"{sum(copied.values())} messages of {len(copied)} topics"])
    return [
        PageTable(["recording", "size"], files),
        PageTable(["sensor", "topic", "used", "in frames", "calibration from"], sensors, (0, 1, 4)),
        PageTable(["", ""], [fact for fact in facts if fact[1]], (0, 1)),
    ]


def checksums(metadata: Mapping[str, str], result_name: str, digest: str) -> PageTable:
    """The SHA-256 of the recordings, of what was read beside them, of settings and rig, and of the result."""
    none = "none: only a part was processed, or the file changed meanwhile"
    rows = [[one.get("name", ""), one.get("sha256") or none] for one in recorded_inputs(metadata)]
    others = {key: text for key, text in metadata.items() if key.endswith(".sha256") and not key.startswith("input.")}
    rows += [*([key.removesuffix(".sha256"), text] for key, text in others.items()), [result_name, digest]]
    return PageTable(["", "SHA-256"], [[name, code(text)] for name, text in rows], (0, 1))


def _motion(motion: Mapping[str, Any], frames: int) -> str:
    if motion["topics"]:
        corrected = f", corrected for tracks by the clouds in {n}" if (n := motion["frames_from_clouds"]) else ""
        compensated = f"{motion['compensated_frames']} of {frames} frames compensated"
        return f"from {', '.join(motion['topics'])}; {compensated}{corrected}"
    if motion["frames_from_clouds"]:
        return f"sought in the clouds, for tracks alone, in {motion['frames_from_clouds']} of {frames} frames"
    return "none recorded: they stand still"
