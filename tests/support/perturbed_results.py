"""Results with known faults: what `process` wrote, with boxes of single topics changed.

    perturbed(result, faulty, {"/fused/detections": turned(5)})

A change gets the number of the frame, from 0, and the detections of its message, and gives those that are written.
Everything else in the file stays as it is. With the mcap library and rosbags: not with lidcam's own code.
"""

import math
from collections.abc import Callable, Container, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Change = Callable[[int, list[Any]], list[Any]]


def perturbed(
    source: Path,
    target: Path,
    changes: Mapping[str, Change],
    *,
    without_frames: Container[int] = (),
    texts: Mapping[str, Callable[[str], str]] | None = None,
) -> Path:
    """Write a copy of a result with the detections of some topics changed.

    Args:
        source: The result.
        target: The file to write.
        changes: By topic of 3D boxes or of 2D boxes.
        without_frames: Frames that are left out, with all of their messages.
        texts: What changes the attached texts, by name.
    """
    with source.open("rb") as read, target.open("wb") as write:
        reader = make_reader(read)
        header, summary = reader.get_header(), reader.get_summary()
        assert summary is not None
        writer = Writer(write, compression=CompressionType.LZ4)
        writer.start(header.profile, header.library)
        schemas = {one.id: writer.register_schema(one.name, one.encoding, one.data) for one in summary.schemas.values()}
        channels = {
            one.id: writer.register_channel(one.topic, one.message_encoding, schemas[one.schema_id], one.metadata)
            for one in summary.channels.values()
        }
        frames = _frames(source)
        for schema, channel, message in reader.iter_messages():
            frame = frames.get(message.log_time, -1)
            if frame in without_frames:
                continue
            data = message.data
            if change := changes.get(channel.topic):
                assert schema is not None
                store = _store(schema.name, schema.data.decode())
                array: Any = store.deserialize_cdr(message.data, schema.name)
                array.detections = change(frame, list(array.detections))
                data = bytes(store.serialize_cdr(array, schema.name))
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time, message.sequence)
        for one in reader.iter_attachments():
            data = one.data
            if texts and one.name in texts:
                data = texts[one.name](data.decode()).encode()
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, data)
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part
    return target


@lru_cache(maxsize=8)
def _store(name: str, definition: str) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, name))
    return store


def _frames(path: Path) -> dict[int, int]:
    """Number of the frame by log time."""
    with path.open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages(topics=["/fused/detections"])]
    return {log_time: frame for frame, log_time in enumerate(times)}


def turned(by_deg: float) -> Change:
    """Objects are found with another heading."""

    def changed(_: int, detections: list[Any]) -> list[Any]:
        for one in detections:
            rotation = one.bbox.center.orientation
            half = math.atan2(rotation.z, rotation.w) + math.radians(by_deg) / 2
            rotation.z, rotation.w = math.sin(half), math.cos(half)
        return detections

    return changed
