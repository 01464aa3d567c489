"""Rig files: read in every form that lidcam knows, and their text."""

import re
from collections.abc import Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import yaml

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.rig import Rig, TruthVehicle, Zone
from lidcam.pipeline.core.settings.bounded_yaml import MAX_YAML_BYTES, yaml_mapping
from lidcam.pipeline.core.settings.validation import checked
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.readers.messages.tf import clean_frame
from lidcam.readers.rig.schema import POSE, RigFile, parse_rig
from lidcam.readers.rig.topic_names import transport_free

UNREAD = {
    r"\s*<": ("XML, as a URDF is", "write the origins of its joints as `transforms` in a rig file"),
    r'\s*\[\s*\{[^}]*"sensor_token"': (
        "nuScenes' calibrated_sensor.json",
        "write camera_intrinsic as K, translation as translation_m and rotation (w x y z) as rotation_xyzw (x y z w) "
        "of each sensor in a rig file",
    ),
}
"""Names of common forms of calibration that are not read, and what to do, by the beginning of the text."""


def load_rig(path: str | Path) -> RigFile:
    """A rig file of lidcam, or a calibration file of another system; the content says which.

    Known are the files of KITTI, Kalibr's camchain, Autoware's sensors_calibration and sensor_kit_calibration, the
    `ost.yaml` of ROS's camera_calibration, and that of OpenCV's calibration sample.

    Raises:
        CalibrationError: the file cannot be read, or its content does not fit; names the file and the key.
        ConfigError: the file is not a YAML mapping.
    """
    # Most runs have no rig file.
    from lidcam.readers.rig.importers import import_autoware, import_camera_info, import_kalibr, import_kitti

    path = Path(path)
    text = read_small_text(path, MAX_YAML_BYTES, "a rig file", CalibrationError)
    if rig := import_kitti(text, path):
        return rig
    for form, (found, remedy) in UNREAD.items():
        if re.match(form, text):
            raise CalibrationError(f"{path}: expected a rig file (docs/rig.md), found {found}: {remedy}")
    tree = yaml_mapping(text.removeprefix("%YAML:1.0"), path)  # OpenCV's spelling of a directive
    for import_tree in (import_kalibr, import_autoware, import_camera_info):
        if rig := import_tree(tree, path):
            return rig
    if "!!opencv-matrix" in text:
        keys = ", ".join(map(str, tree))
        raise CalibrationError(f"{path}: expected image_width, image_height and camera_matrix of OpenCV, found {keys}")
    return parse_rig(tree, path)


class Row(list[float]):
    """Numbers that are written on one line."""


class _Dumper(yaml.CSafeDumper):
    pass


_Dumper.add_representer(
    Row, lambda dumper, row: dumper.represent_sequence("tag:yaml.org,2002:seq", row, flow_style=True)
)

RIG_HEADER = """\
# Sensors, calibration and zones for lidcam (--rig). Metres, degrees, pixels; x forward, y left, z up (REP 103).
# T_site_lidar maps points of the lidar's frame to the site frame, T_camera_site those of the site frame to the camera's
# optical frame (z forward, x right, y down). What is left out is taken from the recording.
"""


def rig_yaml(rig: Rig) -> str:
    """The text of a rig file, which reads back to the same numbers."""
    tree: dict[str, Any] = {"site_frame": rig.site_frame}
    if rig.ground_height_m is not None:
        tree["ground_height_m"] = rig.ground_height_m
    tree["lidars"] = {
        lidar.name: {
            "topic": lidar.topic,
            "frame_id": lidar.T_site_lidar.src,
            "T_site_lidar": matrix_rows(lidar.T_site_lidar.matrix),
            **time_offset(lidar.time_offset_ns),
        }
        for lidar in rig.lidars
    }
    tree["cameras"] = {
        camera.name: {
            **({"topic": camera.topic} if camera.topic else {}),
            **({"boxes_topic": camera.boxes_topic} if camera.boxes_topic else {}),
            "frame_id": camera.T_camera_site.dst,
            "width_px": camera.model.width_px,
            "height_px": camera.model.height_px,
            "K": matrix_rows(camera.model.K),
            "distortion_model": camera.model.model,
            "distortion": Row(camera.model.distortion.tolist()),
            "T_camera_site": matrix_rows(camera.T_camera_site.matrix),
            **time_offset(camera.time_offset_ns),
        }
        for camera in rig.cameras
    }
    tree["zones"] = {zone.name: zone_tree(zone) for zone in rig.zones}
    if rig.truth:
        tree["truth"] = truth_tree(rig.truth)
    return RIG_HEADER + dumped(tree)


def dumped(tree: Mapping[str, Any], width: int = 120) -> str:
    """A part of a rig file as YAML, in its order; a `Row` stands on one line, of at most `width` characters."""
    return yaml.dump(tree, Dumper=_Dumper, sort_keys=False, width=width, allow_unicode=True)


def zone_tree(zone: Zone) -> list[Row] | dict[str, Any]:
    """The value of a zone."""
    corners = matrix_rows(zone.polygon_site)
    return corners if zone.use == "count" else {"corners": corners, "use": zone.use}


def truth_tree(vehicles: Mapping[str, TruthVehicle]) -> dict[str, Any]:
    """The section `truth`."""
    return {
        name: {
            "topic": vehicle.topic,
            "size_m": Row(vehicle.size_m),
            "offset_m": Row(vehicle.offset_m),
            "class": vehicle.label,
        }
        for name, vehicle in vehicles.items()
    }


def time_offset(offset_ns: int) -> dict[str, float]:
    """The key of a sensor whose stamps are corrected."""
    return {"time_offset_ms": offset_ns / 1e6} if offset_ns else {}


def matrix_rows(matrix: F64) -> list[Row]:
    """A matrix, or corners (N, 2), one row a line."""
    return [Row(row) for row in matrix.tolist()]


Entry = dict[str, Any]

EXTRINSICS = ("T_site_lidar", "T_camera_site", "T_site_camera", "P", *POSE)
INTRINSICS = ("K", "P", "camera_info")
LENS = ("distortion_model", "distortion")


def merge_rigs(rigs: Sequence[tuple[str, RigFile]]) -> RigFile:
    """One rig of several, given with their names: each adds to those before it, and replaces what it gives itself.

    Intrinsics (K and distortion) and extrinsics are replaced as wholes, each on its own: half of one matrix does not go
    with half of another. A sensor is known by its name, else by its topic.

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
