"""The counts of each frame: diagnostic_msgs/DiagnosticArray."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.frame import FrameResult, Missing
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.tracks import NO_TRACK

Values = Sequence[tuple[str, str]]

_SOURCES = {Source.LIDAR: "lidars alone", Source.CAMERA: "cameras alone", Source.BOTH: "both"}

_OK, _WARN = 0, 1  # DiagnosticStatus


def diagnostics(result: FrameResult, rig: Rig, not_copied: Sequence[Drop]) -> Any:
    """Synchronisation, points by step, objects by source, and dropped messages, those of the writer itself included."""
    drops = [*result.drops, *not_copied]
    dropped = [(drop.topic, ": ".join(filter(None, (drop.reason, drop.detail)))) for drop in drops]
    statuses = [
        ("synchronisation", *_synchronisation(result, rig)),
        ("cloud", f"{len(result.combined.cloud)} points", _cloud(result), _OK),
        ("objects", f"{len(result.fused.objects)} objects", _objects(result, rig), _OK),
        ("dropped messages", f"{len(drops)} dropped" if drops else "none", dropped, _WARN if drops else _OK),
    ]
    names, messages, values, levels = zip(*statuses, strict=True)
    rows = ROS2.rows(
        "diagnostic_msgs/msg/DiagnosticStatus",
        len(statuses),
        level=[*levels],
        name=[f"lidcam: {name}" for name in names],
        message=[*messages],
        values=[[ROS2.new("diagnostic_msgs/msg/KeyValue", *pair) for pair in pairs] for pairs in values],
    )
    header = ROS2.header(result.bundle.stamp_ns, rig.site_frame)
    return ROS2.new("diagnostic_msgs/msg/DiagnosticArray", header, rows)


def _synchronisation(result: FrameResult, rig: Rig) -> tuple[str, Values, int]:
    """Skew, offset of each message, missing sensors; a warning where one is silent."""
    bundle, names = result.bundle, rig.sensor_of_topic
    missing = [(f"missing {names.get(topic, topic)}", why) for topic, why in bundle.missing.items()]
    offsets = [
        (f"offset_ms {topic}", f"{(message.stamp_ns - bundle.stamp_ns) / 1e6:.3f}")
        for topic, message in sorted(bundle.messages.items())
    ]
    dropped = [
        (f"left out {topic}", f"{count}: {reason}") for (topic, reason), count in sorted(bundle.dropped_before.items())
    ]
    values = [("frame", str(bundle.index)), ("skew_ms", f"{bundle.skew_ns / 1e6:.3f}"), *missing, *offsets, *dropped]
    lacking = f", without {', '.join(names.get(topic, topic) for topic in bundle.missing)}" if missing else ""
    level = _WARN if Missing.SILENT in bundle.missing.values() else _OK
    return f"skew {bundle.skew_ns / 1e6:.3f} ms{lacking}", values, level


def _cloud(result: FrameResult) -> Values:
    steps = [(f"points {step}", str(count)) for step, count in result.combined.counts.items()]
    return [*steps, ("motion compensated", ", ".join(result.combined.compensated) or "none")]


def _objects(result: FrameResult, rig: Rig) -> Values:
    detected = {camera.name: result.detections.cameras.get(camera.name, ()) for camera in rig.cameras}
    matched = {camera.name: result.matches.get(camera.name, ()) for camera in rig.cameras}
    placed, begin_nothing = result.detections.placed, result.hypotheses.boxes_without_object
    sources = np.bincount(result.fused.objects.sources, minlength=len(Source))
    tracked = []
    if (tracks := result.fused.tracks) is not None:
        tracked = [("tracks", str(int((tracks.ids != NO_TRACK).sum()))), ("predicted", str(sources[Source.PREDICTED]))]
    return [
        ("fused", str(len(result.fused.objects))),
        ("confirmed by cameras", str(int((result.fused.matched > 0).sum()))),
        *((f"fused from {name}", str(sources[source])) for source, name in _SOURCES.items()),
        *tracked,
        ("detected lidar", str(len(result.detections.lidar))),
        *(() if placed is None else [("placed by cameras", str(len(placed)))]),
        ("proposed by cameras", str(len(result.hypotheses.boxes) - result.hypotheses.lidar_count)),
        *((f"detected {name}", str(len(boxes))) for name, boxes in detected.items()),
        *((f"matched {name}", str(len(pairs))) for name, pairs in matched.items()),
        *((f"recorded boxes left out, {reason}", str(count)) for reason, count in sorted(result.unused_boxes.items())),
        *((f"recorded 3D boxes left out, {reason}", str(n)) for reason, n in sorted(result.unused_boxes3d.items())),
        *((f"2D boxes without an object, {reason}", str(n)) for reason, n in sorted(begin_nothing.items())),
        *((f"not reported, {reason}", str(count)) for reason, count in sorted(result.fused.left_out.items())),
    ]
