"""Reads ASAM OpenLABEL 1.0 (asam.net/standards/detail/openlabel): cuboids by frame, and coordinate systems.

Also as the TUM Traffic dataset has it, where an object's type stands in its data, and a cuboid is one, not a list.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.errors import RecordingError
from pipeline.core.geometry.rotations import matrix_of_quaternion, matrix_of_rpy
from pipeline.core.messages import time_fault
from pipeline.evaluation.evaluation_frame import UNKNOWN
from readers.truth.boxes import MAX_OFF_UNIT

__all__ = ["Cuboid", "OpenLabelFile", "OpenLabelFrame", "parse_openlabel"]

_SECONDS = ((10**17, 1), (10**14, 10**3), (10**11, 10**6), (0, 10**9))
"""Numbers from which times are ns, us, ms and s: no recording is from before 1973."""


@dataclass(frozen=True, slots=True, eq=False)
class Cuboid:
    """One object of a frame.

    Attributes:
        uuid: Key of the object.
        label: Its type.
        T_system_box: (4, 4) pose of its centre.
        size_m: Along x, y and z.
        system: Coordinate system that it names; empty if none.
        lidar_points: The attribute `num_points`; `UNKNOWN` without.
    """

    uuid: str
    label: str
    T_system_box: F64
    size_m: tuple[float, float, float]
    system: str
    lidar_points: int


@dataclass(frozen=True, slots=True, eq=False)
class OpenLabelFrame:
    """One frame.

    Attributes:
        number: As the file has it.
        stamp_ns: Its timestamp; None without.
        cuboids: In the order of the file.
        without_cuboid: Objects that have no cuboid.
    """

    number: int
    stamp_ns: int | None
    cuboids: tuple[Cuboid, ...]
    without_cuboid: int


@dataclass(frozen=True, slots=True, eq=False)
class OpenLabelFile:
    """The content of a file.

    Attributes:
        frames: In the order of their numbers.
        parents: Parent of each coordinate system; empty for a root.
        poses: (4, 4) T_parent_system, of those that have one.
    """

    frames: tuple[OpenLabelFrame, ...]
    parents: Mapping[str, str]
    poses: Mapping[str, F64]


class _UnfitError(Exception):
    """A part of the file has another form."""


def parse_openlabel(text: str, path: Path) -> OpenLabelFile:
    """The content of an OpenLABEL file.

    Args:
        text: JSON.
        path: Named in errors.

    Raises:
        RecordingError: it is no JSON, or a part of it has not the form of OpenLABEL; says which.
    """
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError) as err:
        raise RecordingError(f"{path}: expected OpenLABEL, found no JSON: {err}") from err
    try:
        root = _part(_mapping(tree, "the file"), "openlabel", "the file")
        objects = root.get("objects", {})
        frames = [
            _frame(key, content, _mapping(objects, "objects"))
            for key, content in _part(root, "frames", "openlabel").items()
        ]
        parents, poses = _systems(_mapping(root.get("coordinate_systems", {}), "coordinate_systems"))
    except _UnfitError as err:
        raise RecordingError(f"{path}: expected OpenLABEL 1.0: {err}") from err
    return OpenLabelFile(tuple(sorted(frames, key=lambda frame: frame.number)), parents, poses)


def _frame(key: str, content: Any, objects: Mapping[str, Any]) -> OpenLabelFrame:
    where = f"frames.{key}"
    if not key.isdecimal() or len(key) > 15:
        raise _UnfitError(f"frames: expected numbers as keys, found {key!r}")
    properties = _mapping(_mapping(content, where).get("frame_properties", {}), f"{where}.frame_properties")
    found = []
    without = 0
    for uuid, of_object in _mapping(content.get("objects", {}), f"{where}.objects").items():
        place = f"{where}.objects.{uuid}"
        data = _mapping(_mapping(of_object, place).get("object_data", {}), f"{place}.object_data")
        named = objects.get(uuid)
        label = data.get("type") or (named.get("type") if isinstance(named, dict) else "") or ""
        cuboids = _listed(data.get("cuboid", []))
        if cuboids:
            found.append(_cuboid(uuid, str(label), cuboids[0], f"{place}.cuboid"))
        without += not cuboids
    return OpenLabelFrame(int(key), _stamp_ns(properties, where), tuple(found), without)


def _cuboid(uuid: str, label: str, content: Any, where: str) -> Cuboid:
    cuboid = _mapping(content, where)
    values = _numbers(cuboid.get("val"), f"{where}.val")
    if len(values) not in (9, 10):
        raise _UnfitError(
            f"{where}.val: expected 10 numbers (position, quaternion, size) or 9 (angles), found {len(values)}"
        )
    pose = np.eye(4)
    pose[:3, 3] = values[:3]
    pose[:3, :3] = _rotation(values[3:-3], f"{where}.val")
    length, width, height = values[-3:]
    if not min(length, width, height) > 0:
        raise _UnfitError(f"{where}.val: expected a box with a volume, found {length:g} x {width:g} x {height:g} m")
    return Cuboid(
        uuid, label, pose, (length, width, height), str(cuboid.get("coordinate_system", "")), _points(cuboid, where)
    )


def _rotation(values: Sequence[float], where: str) -> F64:
    """A quaternion x, y, z, w, or angles about x, y and z, of which that about x is applied first."""
    if len(values) == 3:
        return matrix_of_rpy(values)
    if not abs(math.hypot(*values) - 1) <= MAX_OFF_UNIT:
        raise _UnfitError(f"{where}: expected a quaternion of length 1, found {math.hypot(*values):g}")
    return matrix_of_quaternion(values)


def _points(cuboid: Mapping[str, Any], where: str) -> int:
    """The attribute `num_points`."""
    attributes = _mapping(cuboid.get("attributes", {}), f"{where}.attributes")
    for attribute in _listed(attributes.get("num", [])):
        if isinstance(attribute, dict) and attribute.get("name") == "num_points":
            (count,) = _numbers([attribute.get("val")], f"{where}.attributes.num_points")
            return int(min(max(count, UNKNOWN), np.iinfo(np.int32).max))
    return UNKNOWN


def _stamp_ns(properties: Mapping[str, Any], where: str) -> int | None:
    """The time of a frame, in s, ms, us or ns by its magnitude."""
    value = properties.get("timestamp")
    if value is None:
        return None
    try:
        number = float(value) if isinstance(value, float) or not str(value).isdecimal() else int(value)
        unit = next(unit for least, unit in _SECONDS if number >= least)
        stamp_ns = number * unit if isinstance(number, int) else round(number * unit)
    except (TypeError, ValueError, OverflowError, StopIteration) as err:
        raise _UnfitError(f"{where}.frame_properties.timestamp: expected a time since 1970, found {value!r}") from err
    if fault := time_fault(stamp_ns):
        raise _UnfitError(f"{where}.frame_properties.timestamp: {fault}")
    return stamp_ns


def _systems(content: Mapping[str, Any]) -> tuple[dict[str, str], dict[str, F64]]:
    parents, poses = {}, {}
    for name, of_system in content.items():
        where = f"coordinate_systems.{name}"
        system = _mapping(of_system, where)
        parents[name] = str(system.get("parent") or "")
        pose = _mapping(system.get("pose_wrt_parent") or {}, f"{where}.pose_wrt_parent")
        if pose:
            poses[name] = _pose(pose, f"{where}.pose_wrt_parent")
    return parents, poses


def _pose(content: Mapping[str, Any], where: str) -> F64:
    if "matrix4x4" in content:
        values = _numbers(content["matrix4x4"], f"{where}.matrix4x4")
        if len(values) != 16:
            raise _UnfitError(f"{where}.matrix4x4: expected 16 numbers, found {len(values)}")
        return np.array(values).reshape(4, 4)
    if "quaternion" not in content:
        raise _UnfitError(f"{where}: expected matrix4x4, or quaternion and translation, found {', '.join(content)}")
    pose = np.eye(4)
    quaternion = _numbers(content["quaternion"], f"{where}.quaternion")
    translation = _numbers(content.get("translation", [0, 0, 0]), f"{where}.translation")
    if len(quaternion) != 4 or len(translation) != 3:
        raise _UnfitError(f"{where}: expected a quaternion of 4 and a translation of 3 numbers")
    pose[:3, :3], pose[:3, 3] = _rotation(quaternion, f"{where}.quaternion"), translation
    return pose


def _numbers(value: Any, where: str) -> list[float]:
    if not isinstance(value, list) or not all(_is_number(one) for one in value):
        raise _UnfitError(f"{where}: expected finite numbers, found {_told(value)}")
    return [float(one) for one in value]


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e15  # also false of NaN


def _mapping(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _UnfitError(f"{where}: expected an object, found {_told(value)}")
    return value


def _part(tree: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    if key in tree and not isinstance(tree[key], dict):
        raise _UnfitError(f"{where}: expected a mapping in {key!r}, found {_told(tree[key])}")
    if key not in tree:
        raise _UnfitError(f"{where}: expected {key!r}, found {', '.join(sorted(tree)[:5]) or 'nothing'}")
    found: dict[str, Any] = tree[key]
    return found


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _told(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
