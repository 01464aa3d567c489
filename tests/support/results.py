"""Reading back what lidcam wrote, with the mcap library and rosbags: not with lidcam's own code."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


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


def stamp_of(message: Any) -> int:
    """The stamp of its header in nanoseconds."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def fused_objects(path: Path) -> dict[int, list[Found]]:
    """Fused objects by header stamp in nanoseconds."""
    messages = messages_of(path, "/fused/detections")
    return {stamp_of(message): [*map(_found, message.detections)] for _, message in messages}


def _found(detection: Any) -> Found:
    kind, size = detection.results[0].hypothesis, detection.bbox.size
    place, turn = detection.bbox.center.position, detection.bbox.center.orientation
    yaw = float(2 * np.arctan2(turn.z, turn.w))
    return Found(kind.class_id, kind.score, place.x, place.y, place.z, yaw, size.x, size.y, size.z)
