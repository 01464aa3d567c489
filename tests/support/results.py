"""Reading back what lidcam wrote, with the mcap library and rosbags: not with lidcam's own code."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

__all__ = ["Found", "fused_objects", "messages_of", "topics_of"]


@dataclass(frozen=True)
class Found:
    """One fused object."""

    label: str
    score: float
    x: float
    y: float
    z: float
    yaw: float
    length: float
    width: float
    height: float


def messages_of(path: Path, topic: str) -> list[tuple[int, Any]]:
    """(log time, decoded message) of one topic, by the definitions in the file."""
    found = []
    with path.open("rb") as file:
        for schema, _, message in make_reader(file).iter_messages(topics=[topic]):
            assert schema is not None
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
            found.append((message.log_time, store.deserialize_cdr(message.data, schema.name)))
    return found


def topics_of(path: Path) -> dict[str, tuple[str, int]]:
    """Type and number of messages by topic."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    return {c.topic: (summary.schemas[c.schema_id].name, counts.get(c.id, 0)) for c in summary.channels.values()}


def fused_objects(path: Path) -> dict[int, list[Found]]:
    """Fused objects by header stamp in nanoseconds."""
    frames: dict[int, list[Found]] = {}
    for _, message in messages_of(path, "/fused/detections"):
        stamp = message.header.stamp
        frames[stamp.sec * 10**9 + stamp.nanosec] = [
            Found(
                detection.results[0].hypothesis.class_id,
                detection.results[0].hypothesis.score,
                detection.bbox.center.position.x,
                detection.bbox.center.position.y,
                detection.bbox.center.position.z,
                float(2 * np.arctan2(detection.bbox.center.orientation.z, detection.bbox.center.orientation.w)),
                detection.bbox.size.x,
                detection.bbox.size.y,
                detection.bbox.size.z,
            )
            for detection in message.detections
        ]
    return frames
