"""Printing of inspections and frames."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from lidcam.cli.printing.tables import rows_table, sensors_table, topics_table
from lidcam.cli.printing.terminal import show_line, show_table
from lidcam.cli.verdict import first_of
from lidcam.pipeline.core.detections import NO_HYPOTHESIS, Boxes3D, Fused, source_names
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.engines import ENGINES
from lidcam.pipeline.core.text import listed
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks
from lidcam.readers.messages.tf import TF_TYPES
from lidcam.readers.recording import Loss
from lidcam.readers.rig.sensor_topics import CAMERA_INFO, SensorFault, faults_told
from lidcam.readers.streams.survey import TopicSurvey
from lidcam.run.summary import loss_records
from lidcam.run.warning import RunWarning

if TYPE_CHECKING:  # a run inspects nothing
    from lidcam.inspection import Inspection

MAX_LOSSES = 20
"""Damaged parts in the table."""

NO_MOTION = "none: no odometry or tf of the site frame, or switched off"


def print_detections(out: Console, frame: FrameResult, config: Config) -> None:
    """Print the boxes of the lidars, those placed by the cameras alone, and the fused objects with their sources."""
    lidar, placed, fused = frame.detections.lidar, frame.detections.placed, frame.fused
    out.print(f"frame {frame.bundle.index}  stamp {frame.bundle.stamp_ns} ns  {len(lidar)} lidar detections")
    _print_boxes(out, lidar, config, [f"{count} points" for count in lidar.point_counts.tolist()])
    if placed is not None:
        out.print(f"  {len(placed)} placed by the cameras alone")
        deviations_m = np.sqrt(placed.covariances[:, [0, 1], [0, 1]].sum(1)).tolist()
        _print_boxes(out, placed, config, [f"+- {deviation_m:.2f} m" for deviation_m in deviations_m])
    out.print(f"  {len(fused.objects)} fused objects")
    columns = zip(source_names(fused.objects.sources), fused.rows.tolist(), fused.matched.tolist(), strict=True)
    origins = [
        name if row == NO_HYPOTHESIS else f"{name}, of row {row}, {cameras} cam" for name, row, cameras in columns
    ]
    remarks = [", ".join(filter(None, pair)) for pair in zip(_track_texts(fused), origins, strict=True)]
    _print_boxes(out, fused.objects, config, remarks)


def _track_texts(fused: Fused) -> list[str]:
    """Number, speed and age of the track of each object; empty without one."""
    tracks = Tracks.none(len(fused.objects)) if fused.tracks is None else fused.tracks
    speeds = ["" if np.isnan(speed_m_s) else f"{speed_m_s:.1f} m/s, " for speed_m_s in tracks.speeds]
    columns = zip(tracks.ids.tolist(), speeds, tracks.ages_s.tolist(), strict=True)
    return [
        f"track {number}, {speed}{age_s:.1f} s old" if number != NO_TRACK else "" for number, speed, age_s in columns
    ]


def _print_boxes(out: Console, boxes: Boxes3D, config: Config, remarks: Sequence[str]) -> None:
    for row, remark in enumerate(remarks):
        (x, y, z), (length, width, height) = boxes.centers[row], boxes.sizes[row]
        out.print(
            f"  {row:3} {config.object_names[boxes.class_ids[row]]:10} score {boxes.scores[row]:.2f}"
            f"  x {x:8.2f} y {y:8.2f} z {z:6.2f}  l {length:5.2f} w {width:5.2f} h {height:5.2f}"
            f"  yaw {boxes.yaws[row]:6.3f}  {remark}"
        )


def print_matches(out: Console, frame: FrameResult, config: Config) -> None:
    """Print which 2D box matches which object in one frame, and what only one sensor saw.

    Objects are numbered by their row among the fused ones, 3D boxes that are not reported by their row among the
    hypotheses: the lidars' detections, then those proposed by 2D boxes.
    """
    hypotheses, fused = frame.hypotheses, frame.fused
    names = [f"object {row}" for row in range(len(fused.objects))]
    if fused.tracks is not None:
        numbers = fused.tracks.ids.tolist()
        names = [
            f"{name} (track {number})" if number != NO_TRACK else name
            for name, number in zip(names, numbers, strict=True)
        ]
    reported = {row: name for row, name in zip(fused.rows.tolist(), names, strict=True) if row != NO_HYPOTHESIS}

    def name_of(row: int) -> str:
        return reported.get(row, f"3D box {row} (not reported)")

    out.print(f"frame {frame.bundle.index}  stamp {frame.bundle.stamp_ns} ns  matches")
    matched: set[int] = set()
    for camera, boxes2d in frame.detections.cameras.items():
        matches = frame.matches[camera]
        for (row3d, row2d), iou in zip(matches.pairs.tolist(), matches.iou.tolist(), strict=True):
            name = config.class_names[boxes2d.class_ids[row2d]]
            out.print(f"  {camera}: 2D box {row2d} ({name}) is {name_of(row3d)}, IoU {iou:.2f}")
            matched.add(row3d)
        alone = sorted(set(range(len(boxes2d))) - set(matches.pairs[:, 1].tolist()))
        if alone:
            out.print(f"  {camera}: seen by the camera alone: {', '.join(map(str, alone))}")
    proposed = range(hypotheses.lidar_count, len(hypotheses.boxes))
    for row, source in zip(proposed, source_names(hypotheses.boxes.sources[hypotheses.lidar_count :]), strict=True):
        where = "with points of the lidars" if source == "both" else "placed by the cameras alone"
        out.print(f"  {name_of(row)}: proposed by 2D boxes, {where}")
    alone = sorted(set(range(hypotheses.lidar_count)) - matched)
    listed = [reported[row] for row in alone if row in reported]
    others = [str(row) for row in alone if row not in reported]
    listed += [f"3D box{'es' * (len(others) > 1)} {', '.join(others)} (not reported)"] if others else []
    out.print(f"  seen by the lidars alone: {', '.join(listed) or 'none'}")
    predicted = [name for name, row in zip(names, fused.rows.tolist(), strict=True) if row == NO_HYPOTHESIS]
    if predicted:
        out.print(f"  not detected, predicted by their tracks: {', '.join(predicted)}")


def below_one_name(topics: Iterable[str]) -> str:
    """Topics in a line; several below one name are counted as one."""
    below: dict[str, list[str]] = {}
    for topic in topics:
        below.setdefault("/".join(topic.split("/")[:2]), []).append(topic)
    return listed([f"{name}/* ({len(some)} topics)" if len(some) > 1 else some[0] for name, some in below.items()])


def source_of_boxes3d(source: str, rig: Rig) -> str:
    """The source of 3D boxes in words."""
    words = ENGINES[source].words
    return f"{words} from {listed([one.topic for one in rig.detectors])}" if source == "recorded" else words


def print_inspection(out: Console, inspection: "Inspection", verdict: str = "", *, every_topic: bool = False) -> None:
    """Print the contents of a recording: the verdict first; topics that would not be used in one line.

    Without a verdict, it is what would be lost or left out.
    """
    problem = f"lidcam could not process it: {inspection.problem}" if inspection.problem else ""
    verdict = verdict or problem or first_of(inspection.incomplete) or "sound, and all of its sensors can be used"
    seconds = (inspection.end_ns - inspection.start_ns) / 1e9
    files = ", ".join(map(str, inspection.files))
    if advice := inspection.box_words[1]:
        show_line(out, advice, "bold yellow")
    show_line(out, f"{files}: {inspection.messages} messages, {seconds:.2f} s")
    show_line(out, f"verdict: {verdict}", "bold")
    out.print()
    unused = () if every_topic else _unused(inspection)
    show_table(out, topics_table([topic for topic in inspection.topics if topic not in unused]))
    if unused:
        show_line(out, f"other topics, listed with -v: {below_one_name(topic.topic for topic in unused)}")
    if inspection.stop_ns is not None:
        looked_s = (inspection.stop_ns - inspection.start_ns) / 1e9
        show_line(out, f"only the first {looked_s:g} s were examined, except for the counts: the files are on a server")
    print_losses(out, inspection.losses)
    out.print()
    if inspection.rig is None:
        return
    show_line(out, f"site frame: {inspection.rig.site_frame}")
    show_table(out, sensors_table(inspection.sensors))
    print_remarks(out, inspection.faults, inspection.notes)
    show_line(out, f"motion: {', '.join(inspection.motion_topics) or NO_MOTION}")
    show_line(out, f"3D boxes: {source_of_boxes3d(inspection.box_source_3d, inspection.rig)}")
    show_line(out, f"2D boxes: {inspection.box_words[0]}")
    show_line(out, f"settings: {inspection.settings}")
    print_warnings(out, inspection.warnings)


def _unused(inspection: "Inspection") -> "Sequence[TopicSurvey]":
    """The topics without a remark that are not used for sensors, motion or calibration."""
    if inspection.rig is None:
        return ()
    used = {*inspection.motion_topics, *inspection.rig.sensor_of_topic, *(one.topic for one in inspection.faults)}
    return [
        topic
        for topic in inspection.topics
        if not (topic.topic in used or topic.problem or topic.backwards or topic.msgtype in CAMERA_INFO | TF_TYPES)
    ]


def print_losses(out: Console, losses: Sequence[Loss]) -> None:
    """The table of damaged parts, if there are any."""
    if not losses:
        return
    out.print()
    columns = ("file", "from byte", "bytes", "messages lost", "reason")
    rows = (
        ("unknown" if value is None else value for value in record.values())
        for record in loss_records(losses[:MAX_LOSSES])
    )
    show_table(out, rows_table("damage", columns, rows, ("reason",)))
    if len(losses) > MAX_LOSSES:
        show_line(out, f"  and {len(losses) - MAX_LOSSES} more parts; --json lists all")


def print_remarks(out: Console, faults: Sequence[SensorFault], notes: Sequence[str]) -> None:
    """Print the sensors that were left out, and the notes."""
    for subjects, reason in faults_told(faults):
        show_line(out, f"left out: {subjects}: {reason}")
    for note in notes:
        show_line(out, f"note: {note}")


def print_warnings(out: Console, warnings: Sequence[RunWarning]) -> None:
    """Print warnings."""
    for warning in warnings:
        show_line(out, f"warning: {warning}", "yellow")
