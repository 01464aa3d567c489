"""The schema of a rig file: sensors, calibration and zones.

Every value that is left out is taken from the recording: extrinsics from tf, a camera's intrinsics from CameraInfo, a
topic by its name. Without `lidars` (or `cameras`) all lidars of the recording are used; `{}` means none. Matrices may
be nested or flat. A value `TODO`, as `lidcam inspect --write-rig` writes it, is still missing: the sensor is left out
until somebody gives it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.rotations import matrix_of_quaternion, matrix_of_rpy, pose_matrix
from lidcam.pipeline.core.rig import TruthVehicle
from lidcam.pipeline.core.settings.recording import ZoneConfig
from lidcam.pipeline.core.settings.validation import checked

TODO = "TODO"
"""A value that is still to be given."""


def _shaped(rows: int, columns: int) -> BeforeValidator:
    def flatten(value: Any) -> Any:
        parts = value if isinstance(value, list | tuple) else ()
        flat = [number for part in parts for number in (part if isinstance(part, list | tuple) else [part])]
        if len(flat) != rows * columns:
            raise ValueError(f"expected {rows} x {columns} numbers, found {len(flat)}")
        return flat

    return BeforeValidator(flatten)


Matrix33 = Annotated[tuple[float, ...], _shaped(3, 3)]
Matrix34 = Annotated[tuple[float, ...], _shaped(3, 4)]
Matrix44 = Annotated[tuple[float, ...], _shaped(4, 4)]
Three = tuple[float, float, float]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Metres = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


POSE = ("translation_m", "rotation_xyzw", "rpy_deg")
"""Keys of a pose as translation and rotation."""


class Pose(_Model):
    """The pose of a frame in another, as translation and rotation.

    At most one form of each of the `alternatives` may be given; the last are those of extrinsics.

    Attributes:
        translation_m: Position of its origin.
        rotation_xyzw: Orientation as a unit quaternion.
        rpy_deg: Orientation as roll about x, then pitch about y, then yaw about z of the other frame (REP 103).
    """

    alternatives: ClassVar[tuple[tuple[tuple[str, ...], ...], ...]] = ((("rotation_xyzw",), ("rpy_deg",)),)

    translation_m: Three | None = None
    rotation_xyzw: tuple[float, float, float, float] | None = None
    rpy_deg: Three | None = None

    @property
    def given(self) -> set[str]:
        """Keys that have a value."""
        return {*self.model_dump(exclude_none=True)}

    def matrix(self) -> F64:
        """T_other_this (4, 4) from translation and rotation; what is not given is zero.

        Raises:
            CalibrationError: the quaternion is not of unit length.
        """
        rotation = matrix_of_rpy(np.deg2rad(self.rpy_deg or (0.0, 0.0, 0.0)))
        if self.rotation_xyzw is not None:
            length = float(np.linalg.norm(self.rotation_xyzw))
            if not abs(length - 1) <= 0.01:
                raise CalibrationError(f"rotation_xyzw: expected a quaternion of length 1, found {length:g}")
            rotation = matrix_of_quaternion(self.rotation_xyzw)
        return pose_matrix(rotation, self.translation_m or 0.0)

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        for forms in self.alternatives:
            found = [keys[0] for form in forms if (keys := [key for key in form if key in self.given])]
            if len(found) > 1:
                raise ValueError(f"extrinsics are given twice, as {' and '.join(found)}: keep one")
        return self


class _Sensor(Pose):
    """A sensor, optionally with its pose in the site frame.

    Attributes:
        topic: Topic of its clouds or images; empty: the recording's topic of that name, else by order.
        frame_id: Its frame; empty: as recorded; a lidar whose messages name none gets the one that tf has by its name.
        parent: Frame, or sensor of the rig, that its extrinsics refer to in place of the site frame.
        time_offset_ms: Recorded stamp minus time of measurement, in milliseconds; it is taken off the stamps.
        missing: Why a key has no value, by key: it is still `TODO`, or its value cannot be used.
    """

    topic: str = ""
    frame_id: str = ""
    parent: str = ""
    time_offset_ms: float = Field(default=0.0, allow_inf_nan=False)
    missing: dict[str, str] = Field(default_factory=dict)

    @property
    def time_offset_ns(self) -> int:
        """`time_offset_ms` in nanoseconds."""
        return round(self.time_offset_ms * 1e6)

    @property
    def has_pose(self) -> bool:
        """Whether extrinsics are given, in any form."""
        return any(not self.given.isdisjoint(form) for form in self.alternatives[-1])


class LidarEntry(_Sensor):
    """One lidar of a rig file.

    Attributes:
        T_site_lidar: Extrinsics, 4 x 4.
    """

    alternatives = (*Pose.alternatives, (("T_site_lidar",), POSE))

    T_site_lidar: Matrix44 | None = None


class CameraEntry(_Sensor):
    """One camera of a rig file.

    Attributes:
        boxes_topic: Topic of recorded boxes; empty: found by name.
        width_px: Image width; left out: as recorded.
        height_px: Image height; left out: as recorded.
        K: Camera matrix, 3 x 3, pixels.
        distortion_model: `plumb_bob`, `rational_polynomial` or `equidistant`.
        distortion: Coefficients in the order of OpenCV.
        T_camera_site: Extrinsics, 4 x 4.
        T_site_camera: Its inverse.
        P: Site to pixel, 3 x 4, depth positive in front; replaces K and extrinsics.
        camera_info: CameraInfo of a file of camera_calibration, by field (see `import_camera_info`); replaces K.
    """

    alternatives = (
        *Pose.alternatives,
        (("K",), ("P",), ("camera_info",)),
        (("T_camera_site",), ("T_site_camera",), ("P",), POSE),
    )

    boxes_topic: str = ""
    width_px: int | None = None
    height_px: int | None = None
    K: Matrix33 | None = None
    distortion_model: str = "plumb_bob"
    distortion: tuple[float, ...] = ()
    T_camera_site: Matrix44 | None = None
    T_site_camera: Matrix44 | None = None
    P: Matrix34 | None = None
    camera_info: dict[str, str | tuple[float, ...]] | None = None

    @model_validator(mode="after")
    def _has_lens(self) -> Self:
        if self.distortion and self.K is None and self.P is None and not {"K", "P"} & {*self.missing}:
            raise ValueError("distortion without K or P: give both or neither")
        return self


class TruthEntry(_Model):
    """A vehicle of the truth: its odometry was recorded, and its box is known.

    Attributes:
        topic: Topic of its nav_msgs/Odometry.
        size_m: Length, width, height of its box.
        offset_m: Centre of the box in the child frame of the odometry.
        label: Its class (`class` in the file): a class of the settings, or a label of one.
    """

    topic: Annotated[str, Field(min_length=1)]
    size_m: tuple[Metres, Metres, Metres]
    offset_m: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    label: Annotated[str, Field(alias="class", min_length=1)] = "car"


Edges = dict[str, dict[str, Pose]]
"""Poses of frames by parent frame, then by child frame."""


class RigFile(_Model):
    """A rig file.

    Attributes:
        site_frame: Frame that objects are reported in; empty: found in the recording.
        ground_height_m: Expected z of the ground at the site's origin.
        lidars: By name.
        cameras: By name.
        zones: Parts of the site, by name; left out: those of the settings (`rig.zones`).
        transforms: Fixed transforms between frames, in place of the recording's.
        default_transforms: The same, for child frames that neither `transforms` nor the recording's tf has.
        truth: Vehicles whose odometry is truth, by name.
    """

    site_frame: str = ""
    ground_height_m: float | None = None
    lidars: dict[Name, LidarEntry] | None = None
    cameras: dict[Name, CameraEntry] | None = None
    zones: dict[Name, ZoneConfig] | None = None
    transforms: Edges = Field(default_factory=dict)
    default_transforms: Edges = Field(default_factory=dict)
    truth: dict[Name, TruthEntry] = Field(default_factory=dict)

    def __repr__(self) -> str:
        lidars, cameras = ([*sensors] if sensors else [] for sensors in (self.lidars, self.cameras))
        return f"RigFile(site_frame={self.site_frame!r}, lidars={lidars}, cameras={cameras})"

    @property
    def vehicles(self) -> dict[str, TruthVehicle]:
        """`truth` as records."""
        return {name: TruthVehicle(one.topic, one.label, one.size_m, one.offset_m) for name, one in self.truth.items()}

    @model_validator(mode="after")
    def _names_are_unique(self) -> "RigFile":
        if twice := sorted(set(self.lidars or ()) & set(self.cameras or ())):
            raise ValueError(f"{', '.join(twice)} names a lidar and a camera: every sensor needs a name of its own")
        for edges in (self.transforms, self.default_transforms):
            children = [child for row in edges.values() for child in row]
            if twice := sorted({child for child in children if children.count(child) > 1}):
                raise ValueError(f"transforms: {twice[0]} has two parents: keep one")
        return self


def parse_rig(tree: Mapping[str, Any], path: Path) -> RigFile:
    """The content of the rig file at `path`.

    Raises:
        CalibrationError: a key is unknown or a value does not fit; names `path`.
    """
    tree = {key: _without_todo(part, path) if key in ("lidars", "cameras") else part for key, part in tree.items()}
    return checked(RigFile, tree, path, CalibrationError)


def _without_todo(sensors: Any, path: Path) -> Any:
    """Sensors by name, with every value that is still to be given under `missing`."""
    if not isinstance(sensors, Mapping):
        return sensors
    parsed = {}
    for name, entry in sensors.items():
        items = entry.items() if isinstance(entry, Mapping) else ()
        todo = {key for key, value in items if isinstance(key, str) and _is_todo(value)}
        parsed[name] = entry
        if todo:
            given = {key: value for key, value in entry.items() if key not in todo}
            parsed[name] = given | {"missing": dict.fromkeys(sorted(todo), f"still {TODO} in {path.name}")}
    return parsed


def _is_todo(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_is_todo, value))
    return isinstance(value, str) and value.strip() == TODO
