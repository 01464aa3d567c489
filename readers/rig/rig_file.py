"""The rig file (YAML): sensors, calibration and zones, written by people or by `write_rig`.

Every value that is left out is taken from the recording: a lidar's or camera's extrinsics from tf, a camera's
intrinsics from CameraInfo, a topic by its name. Without `lidars` (or `cameras`) all that the recording has take part;
`{}` means none. Matrices may be nested or flat.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from scipy.spatial.transform import Rotation

from pipeline.core.arrays import F64
from pipeline.core.errors import CalibrationError, OutputError
from pipeline.core.rig import Rig
from pipeline.core.settings.load import describe_validation

__all__ = ["CameraEntry", "LidarEntry", "RigFile", "parse_rig", "rig_yaml", "write_rig"]


def _shaped(rows: int, columns: int) -> BeforeValidator:
    def flatten(value: Any) -> Any:
        flat = [n for row in value for n in row] if _is_nested(value) else value
        if not isinstance(flat, list | tuple) or len(flat) != rows * columns:
            found = f"{len(flat)} of them" if isinstance(flat, list | tuple) else "something else"
            raise ValueError(f"expected {rows} x {columns} numbers, found {found}")
        return tuple(flat)

    return BeforeValidator(flatten)


def _is_nested(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(row, list | tuple) for row in value)


Matrix33 = Annotated[tuple[float, ...], _shaped(3, 3)]
Matrix34 = Annotated[tuple[float, ...], _shaped(3, 4)]
Matrix44 = Annotated[tuple[float, ...], _shaped(4, 4)]
Three = tuple[float, float, float]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Posed(_Model):
    """A sensor's pose in the site frame in parts.

    Attributes:
        translation_m: Where the sensor is.
        rotation_xyzw: How it is turned, as a unit quaternion.
        rpy_deg: The same as roll about x, then pitch about y, then yaw about z of the site (REP 103), degrees.
    """

    translation_m: Three | None = None
    rotation_xyzw: tuple[float, float, float, float] | None = None
    rpy_deg: Three | None = None

    def pose_in_site(self) -> F64 | None:
        """T_site_sensor (4, 4) from the parts; None without parts.

        Raises:
            CalibrationError: the quaternion is none of unit length.
        """
        if self.translation_m is None and self.rotation_xyzw is None and self.rpy_deg is None:
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


def _at_most_one(entry: BaseModel, *forms: tuple[str, ...]) -> None:
    """Refuse extrinsics that are given in two ways."""
    given = [key for form in forms if (key := next((k for k in form if getattr(entry, k) is not None), None))]
    if len(given) > 1:
        raise ValueError(f"extrinsics are given twice, as {' and '.join(given)}: keep one")


class LidarEntry(_Posed):
    """One lidar of a rig file.

    Attributes:
        topic: Topic of its clouds; empty: the recording's topic of that name, else in order.
        frame_id: Its frame; empty: as its messages say; packets that name none have one that tf knows by its name.
        T_site_lidar: Extrinsics, 4 x 4.
    """

    topic: str = ""
    frame_id: str = ""
    T_site_lidar: Matrix44 | None = None

    @model_validator(mode="after")
    def _one_form(self) -> "LidarEntry":
        _at_most_one(self, ("T_site_lidar",), ("translation_m", "rotation_xyzw", "rpy_deg"))
        _at_most_one(self, ("rotation_xyzw",), ("rpy_deg",))
        return self

    @property
    def is_posed(self) -> bool:
        """Whether the rig file says where the lidar is."""
        return any(v is not None for v in (self.T_site_lidar, self.translation_m, self.rotation_xyzw, self.rpy_deg))


class CameraEntry(_Posed):
    """One camera of a rig file.

    Attributes:
        topic: Topic of its images; empty: the recording's topic of that name, else in order.
        boxes_topic: Topic of recorded boxes; empty: found by name.
        frame_id: Its optical frame; empty: as the recording says.
        width_px: Image width; left out: as recorded.
        height_px: Image height; left out: as recorded.
        K: Camera matrix, 3 x 3, pixels.
        distortion_model: `plumb_bob`, `rational_polynomial` or `equidistant`.
        distortion: Coefficients in the order of OpenCV.
        T_camera_site: Extrinsics, 4 x 4.
        T_site_camera: The same the other way round.
        P: Site to pixel, 3 x 4, depth positive in front: in place of K and extrinsics.
    """

    topic: str = ""
    boxes_topic: str = ""
    frame_id: str = ""
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
        matrices = (("T_camera_site",), ("T_site_camera",), ("P",))
        _at_most_one(self, *matrices, ("translation_m", "rotation_xyzw", "rpy_deg"))
        _at_most_one(self, ("rotation_xyzw",), ("rpy_deg",))
        _at_most_one(self, ("K",), ("P",))
        if self.distortion and self.K is None and self.P is None:
            raise ValueError("distortion without K or P: give both or neither")
        return self


class RigFile(_Model):
    """A rig file.

    Attributes:
        site_frame: Frame that objects are reported in; empty: as found in the recording.
        ground_height_m: Expected z of the ground at the site's origin.
        lidars: By name.
        cameras: By name.
        zones: Corners x, y in the site frame, by name; left out: `intersection` y >= 0, `circle` y < 0.
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
        posed = [name for name, lidar in (self.lidars or {}).items() if lidar.is_posed]
        if posed and not self.site_frame:
            raise ValueError(f"site_frame is missing: name the frame that the pose of {', '.join(posed)} is given in")
        return self


def parse_rig(tree: Mapping[str, Any], path: Path) -> RigFile:
    """A rig file's content.

    Raises:
        CalibrationError: a key is unknown or a value does not fit; `path` is named.
    """
    try:
        return RigFile.model_validate(tree)
    except ValidationError as err:
        raise CalibrationError(f"{path}: {describe_validation(RigFile, err)}") from err


class _Row(list[float]):
    """A row of numbers that is written on one line."""


class _Dumper(yaml.SafeDumper):
    pass


_Dumper.add_representer(
    _Row, lambda dumper, row: dumper.represent_sequence("tag:yaml.org,2002:seq", row, flow_style=True)
)

_HEADER = """\
# Sensors, calibration and zones for lidcam (--rig). Metres, degrees, pixels; x forward, y left, z up (REP 103).
# T_site_lidar maps points of the lidar's frame to the site frame, T_camera_site those of the site frame to the camera's
# optical frame (z forward, x right, y down). What is left out is taken from the recording.
"""


def rig_yaml(rig: Rig) -> str:
    """A rig as the text of a rig file that reads back to the same numbers."""
    tree: dict[str, Any] = {"site_frame": rig.site_frame}
    if rig.ground_height_m is not None:
        tree["ground_height_m"] = rig.ground_height_m
    tree["lidars"] = {
        lidar.name: {
            "topic": lidar.topic,
            "frame_id": lidar.T_site_lidar.src,
            "T_site_lidar": _rows(lidar.T_site_lidar.matrix),
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
            "K": _rows(camera.model.K),
            "distortion_model": camera.model.model,
            "distortion": _Row(camera.model.distortion.tolist()),
            "T_camera_site": _rows(camera.T_camera_site.matrix),
        }
        for camera in rig.cameras
    }
    tree["zones"] = {zone.name: _rows(zone.polygon_site) for zone in rig.zones}
    return _HEADER + yaml.dump(tree, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True)


def write_rig(rig: Rig, path: Path) -> None:
    """Write `rig_yaml`; the file appears whole or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_text(rig_yaml(rig), encoding="utf-8")
        part.replace(path)
    except OSError as err:
        part.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written: {err}") from err


def _rows(matrix: F64) -> list[_Row]:
    return [_Row(row) for row in matrix.tolist()]
