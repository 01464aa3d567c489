"""What a rig file says: sensors, calibration and zones.

Every value that is left out is taken from the recording: extrinsics from tf, a camera's intrinsics from CameraInfo, a
topic by its name. Without `lidars` (or `cameras`) all lidars of the recording are used; `{}` means none. Matrices may
be nested or flat.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from pipeline.core.arrays import F64
from pipeline.core.errors import CalibrationError
from pipeline.core.settings.validation.check import checked

__all__ = ["CameraEntry", "LidarEntry", "RigFile", "parse_rig"]


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
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


_POSE = ("translation_m", "rotation_xyzw", "rpy_deg")


class _Sensor(_Model):
    """A sensor and, optionally, its pose in the site frame as translation and rotation.

    Attributes:
        topic: Topic of its clouds or images; empty: the recording's topic of that name, else by order.
        frame_id: Its frame; empty: as recorded; a lidar whose messages name none gets the one that tf has by its name.
        translation_m: Position of the sensor.
        rotation_xyzw: Orientation as a unit quaternion.
        rpy_deg: Orientation as roll about x, then pitch about y, then yaw about z of the site (REP 103).
    """

    topic: str = ""
    frame_id: str = ""
    translation_m: Three | None = None
    rotation_xyzw: tuple[float, float, float, float] | None = None
    rpy_deg: Three | None = None

    @property
    def given(self) -> set[str]:
        """Keys that have a value."""
        return {*self.model_dump(exclude_none=True)}

    def pose_in_site(self) -> F64 | None:
        """T_site_sensor (4, 4) from translation and rotation; None without either.

        Raises:
            CalibrationError: the quaternion is not of unit length.
        """
        if not self.given & {*_POSE}:
            return None
        matrix = np.eye(4)
        matrix[:3, 3] = self.translation_m or (0.0, 0.0, 0.0)
        if self.rpy_deg is not None:
            matrix[:3, :3] = Rotation.from_euler("xyz", self.rpy_deg, degrees=True).as_matrix()
        if self.rotation_xyzw is not None:
            length = float(np.linalg.norm(self.rotation_xyzw))
            if not abs(length - 1) <= 0.01:
                raise CalibrationError(f"rotation_xyzw: expected a quaternion of length 1, found {length:g}")
            matrix[:3, :3] = Rotation.from_quat(self.rotation_xyzw).as_matrix()
        return matrix

    def _at_most_one(self, *forms: tuple[str, ...]) -> None:
        """Refuse extrinsics in two forms; a form is a tuple of keys that go together."""
        found = [keys[0] for form in forms if (keys := [key for key in form if key in self.given])]
        if len(found) > 1:
            raise ValueError(f"extrinsics are given twice, as {' and '.join(found)}: keep one")


class LidarEntry(_Sensor):
    """One lidar of a rig file.

    Attributes:
        T_site_lidar: Extrinsics, 4 x 4.
    """

    T_site_lidar: Matrix44 | None = None

    @model_validator(mode="after")
    def _one_form(self) -> "LidarEntry":
        self._at_most_one(("T_site_lidar",), _POSE)
        self._at_most_one(("rotation_xyzw",), ("rpy_deg",))
        return self


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
    """

    boxes_topic: str = ""
    width_px: int | None = None
    height_px: int | None = None
    K: Matrix33 | None = None
    distortion_model: str = "plumb_bob"
    distortion: tuple[float, ...] = ()
    T_camera_site: Matrix44 | None = None
    T_site_camera: Matrix44 | None = None
    P: Matrix34 | None = None

    @model_validator(mode="after")
    def _one_form(self) -> "CameraEntry":
        self._at_most_one(("T_camera_site",), ("T_site_camera",), ("P",), _POSE)
        self._at_most_one(("rotation_xyzw",), ("rpy_deg",))
        self._at_most_one(("K",), ("P",))
        if self.distortion and self.K is None and self.P is None:
            raise ValueError("distortion without K or P: give both or neither")
        return self


class RigFile(_Model):
    """A rig file.

    Attributes:
        site_frame: Frame that objects are reported in; empty: found in the recording.
        ground_height_m: Expected z of the ground at the site's origin.
        lidars: By name.
        cameras: By name.
        zones: Corners x, y in the site frame, by name; left out: those of the settings (`rig.zones`).
    """

    site_frame: str = ""
    ground_height_m: float | None = None
    lidars: dict[Name, LidarEntry] | None = None
    cameras: dict[Name, CameraEntry] | None = None
    zones: dict[Name, Annotated[tuple[tuple[float, float], ...], Field(min_length=3)]] | None = None

    @model_validator(mode="after")
    def _names_are_unique(self) -> "RigFile":
        if twice := sorted(set(self.lidars or ()) & set(self.cameras or ())):
            raise ValueError(f"{', '.join(twice)} names a lidar and a camera: every sensor needs a name of its own")
        posed = [name for name, lidar in (self.lidars or {}).items() if lidar.given & {"T_site_lidar", *_POSE}]
        if posed and not self.site_frame:
            raise ValueError(f"site_frame is missing: name the frame that the pose of {', '.join(posed)} is given in")
        return self


def parse_rig(tree: Mapping[str, Any], path: Path) -> RigFile:
    """The content of the rig file at `path`.

    Raises:
        CalibrationError: a key is unknown or a value does not fit; names `path`.
    """
    return checked(RigFile, tree, path, CalibrationError)
