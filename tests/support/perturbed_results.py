"""Results with known faults: what `process` wrote, with boxes of single topics changed.

    perturbed(result, faulty, {"/fused/detections": turned(5)})

A change gets the number of the frame, from 0, and the detections of its message, and gives those that are written;
`in_turn` makes several of them one. Everything else in the file stays as it is. With the mcap library and rosbags: not
with lidcam's own code.
"""

import math
from collections.abc import Callable, Collection, Container, Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

__all__ = [
    "Change",
    "doubled",
    "dropped",
    "flipped",
    "followed",
    "in_turn",
    "nearest_to",
    "of_class",
    "perturbed",
    "shifted",
    "turned",
]

Change = Callable[[int, list[Any]], list[Any]]
Which = Callable[[list[Any]], list[int]]
"""Rows of the detections that a change is about."""

ALWAYS: range = range(1 << 62)


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


def in_turn(*changes: Change) -> Change:
    """All of the changes, one after the other."""

    def changed(frame: int, detections: list[Any]) -> list[Any]:
        for change in changes:
            detections = change(frame, detections)
        return detections

    return changed


def nearest_to(x: float, y: float, *, within_m: float = math.inf) -> Which:
    """The one object that is nearest to a place, if it is near enough."""

    def rows(detections: list[Any]) -> list[int]:
        far = [math.dist((x, y), _xy(one)) for one in detections]
        return [far.index(min(far))] if far and min(far) <= within_m else []

    return rows


def followed(x: float, y: float, *, gate_m: float) -> Which:
    """The object that is at a place in the first frame, as long as it moves less than `gate_m` from frame to frame."""
    place = [x, y]

    def rows(detections: list[Any]) -> list[int]:
        found = nearest_to(place[0], place[1], within_m=gate_m)(detections)
        place[:] = _xy(detections[found[0]]) if found else place
        return found

    return rows


def of_class(name: str) -> Which:
    """All objects of a class."""
    return lambda detections: [row for row, one in enumerate(detections) if _label(one) == name]


def _all(detections: list[Any]) -> list[int]:
    return [*range(len(detections))]


def dropped(which: Which = _all, frames: Collection[int] = ALWAYS) -> Change:
    """Objects are not found."""

    def changed(frame: int, detections: list[Any]) -> list[Any]:
        rows = _rows(which, frame, frames, detections)
        return [one for row, one in enumerate(detections) if row not in rows]

    return changed


def doubled(which: Which = _all, frames: Collection[int] = ALWAYS, *, by_m: float = 0.0) -> Change:
    """Objects are found a second time, somewhat ahead of them."""

    def changed(frame: int, detections: list[Any]) -> list[Any]:
        copies = [deepcopy(detections[row]) for row in _rows(which, frame, frames, detections)]
        for one in copies:
            _center(one).position.x += by_m
        return [*detections, *copies]

    return changed


def shifted(by_m: Sequence[float], which: Which = _all, frames: Collection[int] = ALWAYS) -> Change:
    """Objects are found at another place; 2D boxes, by pixels, have two numbers."""

    def move(one: Any) -> None:
        place = _center(one).position
        for axis, by in zip("xyz", by_m, strict=False):
            setattr(place, axis, getattr(place, axis) + by)

    return _each(move, which, frames)


def turned(by_deg: float, which: Which = _all, frames: Collection[int] = ALWAYS) -> Change:
    """Objects are found with another heading."""

    def turn(one: Any) -> None:
        rotation = _center(one).orientation
        half = math.atan2(rotation.z, rotation.w) + math.radians(by_deg) / 2
        rotation.z, rotation.w = math.sin(half), math.cos(half)

    return _each(turn, which, frames)


def flipped(which: Which = _all, frames: Collection[int] = ALWAYS) -> Change:
    """Front and rear are taken for each other."""
    return turned(180, which, frames)


def _each(change: Callable[[Any], None], which: Which, frames: Collection[int]) -> Change:
    def changed(frame: int, detections: list[Any]) -> list[Any]:
        for row in _rows(which, frame, frames, detections):
            change(detections[row])
        return detections

    return changed


def _rows(which: Which, frame: int, frames: Collection[int], detections: list[Any]) -> list[int]:
    """The rows in this frame; looked for in every frame, so that an object can be followed."""
    rows = which(detections)
    return rows if frame in frames else []


def _label(detection: Any) -> str:
    return str(detection.results[0].hypothesis.class_id)


def _center(detection: Any) -> Any:
    return detection.bbox.center


def _xy(detection: Any) -> tuple[float, float]:
    place = _center(detection).position
    return place.x, place.y
