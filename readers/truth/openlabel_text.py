"""Reads ASAM OpenLABEL 1.0 (asam.net/standards/detail/openlabel): cuboids by frame, and coordinate systems.

Also as the TUM Traffic dataset has it, where an object's type stands in its data, and a cuboid is one, not a list.
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StrictFloat, field_validator, model_validator

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.geometry.rotations import matrix_of_quaternion, matrix_of_rpy
from lidcam.pipeline.core.messages import time_fault
from lidcam.pipeline.core.settings.validation import checked
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.truth.boxes import MAX_OFF_UNIT

MAX_OPENLABEL_BYTES = 64 << 20
"""Of one file; of a longer sequence each frame is a file of its own."""

MAX_OPENLABEL_VALUES = 6_000_000
"""Of one file, some 100 bytes each in memory: ten thousand frames of thirty objects."""

EXPECTED = "expected OpenLABEL 1.0"

_SECONDS = ((10**17, 1), (10**14, 10**3), (10**11, 10**6), (0, 10**9))
"""Numbers from which times are ns, us, ms and s: no recording is from before 1973."""


def _rotation(values: Sequence[float]) -> F64:
    """A quaternion x, y, z, w, or angles about x, y and z, of which that about x is applied first."""
    if len(values) == 3:
        return matrix_of_rpy(values)
    _check_unit(values)
    return matrix_of_quaternion(values)


def _check_unit(quaternion: Sequence[float]) -> None:
    if not abs(math.hypot(*quaternion) - 1) <= MAX_OFF_UNIT:
        raise ValueError(f"expected a quaternion of length 1, found {math.hypot(*quaternion):g}")


def _stamp_ns(value: Any) -> int | None:
    """A time in s, ms, us or ns, by its magnitude."""
    if value is None:
        return None
    try:
        number = float(value) if isinstance(value, float) or not str(value).isdecimal() else int(value)
        unit = next(unit for least, unit in _SECONDS if number >= least)
        stamp_ns = number * unit if isinstance(number, int) else round(number * unit)
    except (TypeError, ValueError, OverflowError, StopIteration) as err:
        raise ValueError(f"expected a time since 1970, found {value!r}") from err
    if fault := time_fault(stamp_ns):
        raise ValueError(fault)
    return stamp_ns


Number = Annotated[StrictFloat, Field(gt=-1e15, lt=1e15)]
Listed = BeforeValidator(lambda value: value if isinstance(value, list) else [value])
Text = Annotated[str, BeforeValidator(lambda value: str(value or ""))]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class _Count(_Part):
    name: Text = ""
    val: Any = None


class _Attributes(_Part):
    num: Annotated[list[_Count], Listed] = []


class Cuboid(_Part):
    """One box.

    Attributes:
        val: Position, quaternion (x, y, z, w) or angles, and size.
        coordinate_system: Coordinate system that it names; empty if none.
        attributes: Further numbers, `num_points` among them.
    """

    val: list[Number]
    coordinate_system: Text = ""
    attributes: _Attributes = _Attributes()

    @field_validator("val")
    @classmethod
    def _is_box(cls, val: list[float]) -> list[float]:
        if len(val) not in (9, 10):
            raise ValueError(f"expected 10 numbers (position, quaternion, size) or 9 (angles), found {len(val)}")
        if len(val) == 10:
            _check_unit(val[3:7])
        if not min(val[-3:]) > 0:
            raise ValueError(f"expected a box with a volume, found {' x '.join(f'{size:g}' for size in val[-3:])} m")
        return val

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Along x, y and z."""
        length, width, height = self.val[-3:]
        return length, width, height

    def T_system_box(self) -> F64:
        """(4, 4) pose of its centre."""
        pose = np.eye(4)
        pose[:3, 3], pose[:3, :3] = self.val[:3], _rotation(self.val[3:-3])
        return pose

    @property
    def lidar_points(self) -> int:
        """The attribute `num_points`; `UNKNOWN` without."""
        counts = [one.val for one in self.attributes.num if one.name == "num_points"]
        known = counts and isinstance(counts[0], int | float) and math.isfinite(counts[0])
        return int(min(max(counts[0], UNKNOWN), np.iinfo(np.int32).max)) if known else UNKNOWN


class _ObjectData(_Part):
    type: Text = ""
    cuboid: Annotated[list[Cuboid], Listed] = []


class _Object(_Part):
    object_data: _ObjectData = _ObjectData()


class _FrameProperties(_Part):
    timestamp: Annotated[int | None, BeforeValidator(_stamp_ns)] = None


class OpenLabelFrame(_Part):
    """One frame.

    Attributes:
        frame_properties: Its timestamp in nanoseconds; None without.
        objects: By their keys.
    """

    frame_properties: _FrameProperties = _FrameProperties()
    objects: dict[str, _Object] = {}


class _Pose(_Part):
    matrix4x4: Annotated[list[Number], Field(min_length=16, max_length=16)] | None = None
    quaternion: Annotated[list[Number], Field(min_length=4, max_length=4)] | None = None
    translation: Annotated[list[Number], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]

    @model_validator(mode="after")
    def _is_pose(self) -> "_Pose":
        self.matrix()
        return self

    def matrix(self) -> F64:
        """(4, 4) T_parent_system."""
        if self.matrix4x4 is not None:
            return np.array(self.matrix4x4).reshape(4, 4)
        if self.quaternion is None:
            raise ValueError("expected matrix4x4, or quaternion and translation")
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = _rotation(self.quaternion), self.translation
        return matrix


class _System(_Part):
    parent: Text = ""
    pose_wrt_parent: Annotated[_Pose | None, BeforeValidator(lambda value: value or None)] = None


class OpenLabel(_Part):
    """The content of a file.

    Attributes:
        frames: By their numbers, as they stand in the file: `frame` checks one.
        objects: Properties of an object that are the same in all frames, by its key.
        coordinate_systems: By name, with their poses in those that they stand in.
    """

    frames: dict[int, Any]
    objects: dict[str, Any] = {}
    coordinate_systems: dict[str, _System] = {}

    @field_validator("frames", mode="before")
    @classmethod
    def _are_numbered(cls, frames: Any) -> Any:
        if other := [key for key in frames if not (key.isdecimal() and len(key) <= 15)] if type(frames) is dict else []:
            raise ValueError(f"expected numbers as keys, found {other[0]!r}")
        return frames

    def object_keys(self, number: int) -> list[str]:
        """The keys of the objects of a frame, which is not checked for it."""
        objects = self.frames[number].get("objects") if isinstance(self.frames[number], dict) else None
        return [*objects] if isinstance(objects, dict) else []

    def frame(self, number: int, path: Path) -> OpenLabelFrame:
        """A frame; `path` is named in errors.

        Raises:
            RecordingError: it has not the form of OpenLABEL; says which part.
        """
        tree = {"openlabel": {"frames": {str(number): self.frames[number]}}}
        return checked(_CheckedFile, tree, f"{path}: {EXPECTED}", RecordingError).openlabel.frames[number]

    def label_of(self, uuid: str, data: _ObjectData) -> str:
        """The type of an object; empty without."""
        named = self.objects.get(uuid)
        return data.type or (str(named.get("type") or "") if isinstance(named, dict) else "")


class _File(_Part):
    openlabel: OpenLabel


class _CheckedFrames(_Part):
    frames: dict[int, OpenLabelFrame]


class _CheckedFile(_Part):
    openlabel: _CheckedFrames


def read_openlabel(path: Path) -> OpenLabel:
    """The content of an OpenLABEL file.

    Raises:
        RecordingError: it cannot be read, is too large, is no JSON, or a part of it has not the form of OpenLABEL.
    """
    text = read_small_text(path, MAX_OPENLABEL_BYTES, "OpenLABEL", RecordingError)
    if (count := sum(map(text.count, ",[{"))) > MAX_OPENLABEL_VALUES:
        raise RecordingError(
            f"{path}: expected OpenLABEL of at most {MAX_OPENLABEL_VALUES} values, found {count}: give a folder with a "
            "file for each frame"
        )
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError) as err:
        raise RecordingError(f"{path}: expected OpenLABEL, found no JSON: {err}") from err
    return checked(_File, tree, f"{path}: {EXPECTED}", RecordingError).openlabel
