"""Several rig files as one: each later one adds to those before it, and replaces what it gives itself.

Intrinsics (K and distortion) and extrinsics are replaced as wholes, each on its own: half of one matrix does not go
with half of another. A sensor is known by its name, else by its topic.
"""

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.settings.validation import checked
from lidcam.readers.messages.tf import clean_frame
from lidcam.readers.rig.schema import POSE, RigFile
from lidcam.readers.rig.topic_names import transport_free

Entry = dict[str, Any]

EXTRINSICS = ("T_site_lidar", "T_camera_site", "T_site_camera", "P", *POSE)
INTRINSICS = ("K", "P")
LENS = ("distortion_model", "distortion")


def merge_rigs(rigs: Sequence[tuple[str, RigFile]]) -> RigFile:
    """One rig of several, given with their names, in their order.

    Raises:
        CalibrationError: two of them name different site frames, or different frames of one sensor; or what they say
            together is no rig.
    """
    if len(rigs) == 1:
        return rigs[0][1]
    names = [name for name, _ in rigs]
    trees = [(name, rig.model_dump(exclude_unset=True, by_alias=True)) for name, rig in rigs]
    nothing: tuple[str, Entry] = "", {}
    _, merged = reduce(_merge, trees, nothing)
    return checked(RigFile, merged, " and ".join(names), CalibrationError)


def _merge(first: tuple[str, Entry], second: tuple[str, Entry]) -> tuple[str, Entry]:
    """Two rigs, each with the names of its files."""
    (name, tree), (other, later) = first, second
    files = f"{name} and {other}" if name else other
    _check_frames(f"{files}: site_frame", tree.get("site_frame"), later.get("site_frame"))
    merged = tree | {key: value for key, value in later.items() if value not in (None, "")}
    for kind in ("lidars", "cameras"):
        if later.get(kind) is not None:
            merged[kind] = _merge_sensors(files, tree.get(kind) or {}, later[kind])
    for kind in ("transforms", "default_transforms"):
        merged[kind] = _merge_edges(tree.get(kind, {}), later.get(kind, {}))
    vehicles, more = tree.get("truth", {}), later.get("truth", {})
    merged["truth"] = vehicles | {name: vehicles.get(name, {}) | entry for name, entry in more.items()}
    return files, merged


def _merge_sensors(files: str, sensors: Mapping[str, Entry], later: Mapping[str, Entry]) -> dict[str, Entry]:
    merged = dict(sensors)
    by_topic = {transport_free(entry["topic"]): name for name, entry in sensors.items() if entry.get("topic")}
    known = {name: name for name in sensors}
    for name, entry in later.items():
        topic = transport_free(entry.get("topic", ""))
        known[name] = name if name in sensors else by_topic.get(topic, name)
    for name, entry in later.items():
        entry = entry | {"parent": known.get(entry["parent"], entry["parent"])} if entry.get("parent") else entry
        merged[known[name]] = _merge_entries(f"{files}: {known[name]}", merged.get(known[name], {}), entry)
    return merged


def _merge_entries(where: str, entry: Entry, later: Entry) -> Entry:
    """One sensor's entry, with what a later file says of it."""
    _check_frames(f"{where}.frame_id", entry.get("frame_id"), later.get("frame_id"))
    given = {key for key, value in later.items() if value is not None}
    replaced = {*EXTRINSICS, "parent"} if given & {*EXTRINSICS} else set[str]()
    replaced |= {*INTRINSICS, *LENS} if given & {*INTRINSICS} else set()
    entry = {key: value for key, value in entry.items() if key not in replaced}
    missing = dict(entry.get("missing", {}))
    missing = {key: why for key, why in missing.items() if not given & {*_group(key)}}
    for key, why in later.get("missing", {}).items():
        if not any(entry.get(one) is not None for one in _group(key)):
            missing[key] = why
    merged = entry | {key: value for key, value in later.items() if value not in (None, "")}
    return merged | {"missing": missing}


def _group(key: str) -> tuple[str, ...]:
    """The keys that say together what this one is part of."""
    return next((group for group in (EXTRINSICS, (*INTRINSICS, *LENS)) if key in group), (key,))


def _merge_edges(edges: Mapping[str, Mapping[str, Entry]], later: Mapping[str, Mapping[str, Entry]]) -> Entry:
    """Transforms by parent and child; a child has the parent that the later file says."""
    children = {child for row in later.values() for child in row}
    kept = {parent: {c: pose for c, pose in row.items() if c not in children} for parent, row in edges.items()}
    return {parent: kept.get(parent, {}) | dict(later.get(parent, {})) for parent in dict.fromkeys([*kept, *later])}


def _check_frames(where: str, frame: str | None, other: str | None) -> None:
    if frame and other and clean_frame(frame) != clean_frame(other):
        raise CalibrationError(f"{where} is {frame!r} in one and {other!r} in the other: keep one of them")
