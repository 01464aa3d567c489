"""What the commands print: what was found in a recording, what became of it, frame by frame and in total."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.text import Text

from lidcam.build import box_source
from lidcam.run import OUTSIDE_ZONES, RunSummary
from lidcam.tables import (
    drops_table,
    losses_table,
    objects_table,
    pairs_table,
    points_table,
    sensors_table,
    stages_table,
    topics_table,
)
from pipeline.core.frame import FrameResult
from pipeline.core.settings.config import Config
from readers.messages.tf import TF_TYPES
from readers.recording import Loss, Recording, TopicInfo
from readers.rig.discovery import Discovery
from readers.rig.sensor_topics import CAMERA_INFO
from readers.streams.motion import MotionSource
from readers.streams.survey import TopicSurvey

__all__ = [
    "Inspection",
    "console",
    "inspection_tree",
    "loss_records",
    "print_detections",
    "print_inspection",
    "print_matches",
    "print_summary",
    "summary_tree",
    "unused_topics",
]

MAX_COLUMNS = 10_000
"""Columns of a table's line at most: more than any table has."""

MAX_LISTED = 10
"""Names in one line at most."""

MAX_LOSSES = 20
"""Damaged places in the table at most."""

_BOX_SOURCES = {
    "onnx": "from the 2D network",
    "recorded": "as recorded",
    "none": "none: lidar-only (no camera with a model given by --model-2d or with recorded boxes)",
}
_NO_MOTION = "none: no odometry or tf of the site frame, or switched off"


def console(*, stderr: bool = False) -> Console:
    """A console that prints text as it is: names of topics and files may look like markup. Lines are never broken."""
    return Console(stderr=stderr, soft_wrap=True, markup=False, emoji=False)


def print_detections(out: Console, frame: FrameResult, config: Config) -> None:
    """What the lidars saw in one frame."""
    boxes = frame.detections.lidar
    out.print(f"frame {frame.bundle.index}  stamp {boxes.stamp_ns} ns  {len(boxes)} lidar detections")
    for row in range(len(boxes)):
        (x, y, z), (length, width, height) = boxes.centers[row], boxes.sizes[row]
        out.print(
            f"  {row:3} {config.class_names[boxes.class_ids[row]]:10} score {boxes.scores[row]:.2f}"
            f"  x {x:8.2f} y {y:8.2f} z {z:6.2f}  l {length:5.2f} w {width:5.2f} h {height:5.2f}"
            f"  yaw {boxes.yaws[row]:6.3f}  {boxes.point_counts[row]} points",
        )


def print_matches(out: Console, frame: FrameResult, config: Config) -> None:
    """Which 2D box is which object in one frame, and what one sensor alone saw."""
    out.print(f"frame {frame.bundle.index}  stamp {frame.bundle.stamp_ns} ns  matches")
    matched: set[int] = set()
    for camera, boxes2d in frame.detections.cameras.items():
        matches = frame.matches[camera]
        for (row3d, row2d), iou in zip(matches.pairs.tolist(), matches.iou.tolist(), strict=True):
            name = config.class_names[boxes2d.class_ids[row2d]]
            out.print(f"  {camera}: object {row3d} is 2D box {row2d} ({name}), IoU {iou:.2f}")
            matched.add(row3d)
        alone = sorted(set(range(len(boxes2d))) - set(matches.pairs[:, 1].tolist()))
        if alone:
            out.print(f"  {camera}: seen by the camera alone: {', '.join(map(str, alone))}")
    alone = sorted(set(range(len(frame.detections.lidar))) - matched)
    out.print(f"  seen by the lidars alone: {', '.join(map(str, alone)) or 'none'}")


def unused_topics(recording: Recording, summary: RunSummary) -> tuple[TopicInfo, ...]:
    """Topics with messages that took no part in a run: neither as data, nor as motion, nor as calibration."""
    used = {*summary.messages_used, *(topic for topic, _ in summary.drops.counts), *summary.motion_topics}
    return tuple(
        info
        for info in recording.topics
        if info.message_count and info.topic not in used and info.msgtype not in CAMERA_INFO | TF_TYPES
    )


def loss_records(losses: Sequence[Loss]) -> list[dict[str, Any]]:
    """What is damaged, for machines: `file`, `position` and `size` in bytes, `messages`, `reason`; None is unknown."""
    return [
        {
            "file": str(loss.path),
            "position": loss.position,
            "size": loss.size,
            "messages": loss.messages,
            "reason": loss.reason,
        }
        for loss in losses
    ]


def print_summary(
    out: Console, summary: RunSummary, found: Discovery, unused: Sequence[TopicInfo], outputs: Sequence[Path]
) -> None:
    """The final table of a run.

    Args:
        out: Where to print.
        summary: The run.
        found: Its rig.
        unused: Topics that took no part.
        outputs: What was written.
    """
    zones = [*(zone.name for zone in found.rig.zones), OUTSIDE_ZONES]
    _show(out, objects_table(summary.objects, zones))
    out.print()
    _show(out, drops_table(summary.messages_used, summary.drops.counts, summary.drops.examples))
    for reason, count in summary.unused_boxes.items():
        out.print(f"  recorded 2D boxes left out: {count}, {reason}")
    _print_losses(out, summary.losses)
    out.print()
    _show(out, stages_table(summary.stage_seconds, summary.frames))
    out.print()
    _show(out, points_table(summary.points, summary.frames))
    out.print()
    compensated = f"{summary.compensated} of {summary.frames} frames compensated"
    facts = {
        "frames": f"{summary.frames}, {summary.frames_per_second:.1f} a second",
        "sync skew": f"{summary.skew_mean_ms:.1f} ms mean, {summary.skew_max_ms:.1f} ms at most",
        "motion": f"{compensated}, from {', '.join(summary.motion_topics)}" if summary.motion_topics else _NO_MOTION,
        "2D boxes": _BOX_SOURCES[summary.box_source],
        "confirmed": f"{summary.confirmed} of {sum(summary.objects.values())} objects by a camera",
        "written": ", ".join(map(str, outputs)),
    }
    _show(out, pairs_table("run", facts))
    _print_remarks(out, found)
    if unused:
        names = [
            f"{info.topic} ({info.message_count}: {info.unreadable})" if info.unreadable else info.topic
            for info in unused
        ]
        more = f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else ""
        out.print(f"not used: {', '.join(names[:MAX_LISTED])}{more}")


def summary_tree(
    summary: RunSummary, found: Discovery, unused: Sequence[TopicInfo], outputs: Sequence[Path]
) -> dict[str, Any]:
    """The final table for machines; arguments as of `print_summary`."""
    drops = [
        {"topic": topic, "reason": reason, "count": count, "example": summary.drops.examples.get((topic, reason), "")}
        for (topic, reason), count in sorted(summary.drops.counts.items())
    ]
    return {
        "frames": summary.frames,
        "frames_per_second": summary.frames_per_second,
        "wall_seconds": summary.wall_seconds,
        "stage_ms": {name: 1e3 * spent / summary.frames for name, spent in summary.stage_seconds.items()},
        "box_source": summary.box_source,
        "motion": {"topics": list(summary.motion_topics), "compensated_frames": summary.compensated},
        "objects": [{"class": c, "zone": z, "count": count} for (c, z), count in summary.objects.items()],
        "confirmed": summary.confirmed,
        "points": dict(summary.points),
        "messages_used": dict(summary.messages_used),
        "drops": drops,
        "losses": loss_records(summary.losses),
        "unused_topics": {info.topic: info.message_count for info in unused},
        "unused_boxes": dict(summary.unused_boxes),
        "sync_skew_ms": {"mean": summary.skew_mean_ms, "max": summary.skew_max_ms},
        "faults": [asdict(fault) for fault in found.faults],
        "notes": list(found.notes),
        "outputs": [str(path) for path in outputs],
    }


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """What was found in a recording.

    Attributes:
        recording: The recording, open.
        config: Settings.
        topics: Its topics.
        found: The rig that lidcam would use; None if it could not process the recording.
        motion: Where the motion of the site frame would come from; None if it stands still.
        problem: Why there is no rig.
        stop_ns: Log time before which it was looked at; None where all of it was.
    """

    recording: Recording
    config: Config
    topics: Sequence[TopicSurvey]
    found: Discovery | None
    motion: MotionSource | None
    problem: str
    stop_ns: int | None = None


def print_inspection(out: Console, inspection: Inspection) -> None:
    """What is in a recording."""
    recording, found = inspection.recording, inspection.found
    seconds = (recording.end_ns - recording.start_ns) / 1e9
    files = ", ".join(str(path) for path in recording.paths)
    out.print(f"{files}: {recording.message_count} messages, {seconds:.2f} s")
    out.print()
    _show(out, topics_table(inspection.topics))
    if inspection.stop_ns is not None:
        looked_s = (inspection.stop_ns - recording.start_ns) / 1e9
        out.print(f"all but the counts is of the first {looked_s:g} s: of files on a server, no more is looked at")
    _print_losses(out, recording.losses)
    out.print()
    if found is None:
        out.print(f"lidcam could not process it: {inspection.problem}")
        return
    out.print(f"site frame: {found.rig.site_frame}")
    _show(out, sensors_table([asdict(source) for source in found.sources]))
    _print_remarks(out, found)
    out.print(f"motion: {', '.join(inspection.motion.topics) if inspection.motion else _NO_MOTION}")
    out.print(f"2D boxes: {_BOX_SOURCES[box_source(inspection.config, found.rig)]}")


def inspection_tree(inspection: Inspection) -> dict[str, Any]:
    """What is in a recording, for machines."""
    recording, found, motion = inspection.recording, inspection.found, inspection.motion
    tree: dict[str, Any] = {
        "files": [str(path) for path in recording.paths],
        "start_ns": recording.start_ns,
        "end_ns": recording.end_ns,
        "messages": recording.message_count,
        "topics": [asdict(topic) for topic in inspection.topics],
        "losses": loss_records(recording.losses),
        "problem": inspection.problem,
        "looked_at_until_ns": inspection.stop_ns,
    }
    if found is not None:
        tree |= {
            "site_frame": found.rig.site_frame,
            "sensors": [asdict(source) for source in found.sources],
            "faults": [asdict(fault) for fault in found.faults],
            "notes": list(found.notes),
            "motion": list(motion.topics) if motion else [],
            "box_source": box_source(inspection.config, found.rig),
        }
    return tree


def _print_losses(out: Console, losses: Sequence[Loss]) -> None:
    """The table of damage; nothing of sound files."""
    if not losses:
        return
    out.print()
    _show(out, losses_table(loss_records(losses[:MAX_LOSSES])))
    if len(losses) > MAX_LOSSES:
        out.print(f"  and {len(losses) - MAX_LOSSES} more places; --json lists all")


def _print_remarks(out: Console, found: Discovery) -> None:
    for fault in found.faults:
        out.print(f"left out: {fault.sensor} ({fault.topic}): {fault.reason}")
    for note in found.notes:
        out.print(f"note: {note}")


def _show(out: Console, table: RenderableType) -> None:
    """Print a table as wide as it needs to be, whatever the terminal: no value cut or broken, no trailing blanks."""
    for line in out.render_lines(table, out.options.update(width=MAX_COLUMNS), pad=False):
        text = Text.assemble(*((segment.text, segment.style or "") for segment in line))
        text.rstrip()
        out.print(text)
