"""Reads calibration files of ROS's velodyne driver (`VLP16db.yaml` and its siblings)."""

from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.settings.bounded_yaml import read_yaml
from lidcam.pipeline.core.settings.validation import checked
from lidcam.readers.velodyne.models import LaserTable, RangeCorrections, VelodyneModel


class _Laser(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    laser_id: int
    rot_correction: float
    vert_correction: float
    dist_correction: float = 0.0
    dist_correction_x: float = 0.0
    dist_correction_y: float = 0.0
    vert_offset_correction: float = 0.0
    horiz_offset_correction: float = 0.0
    focal_distance: float = 0.0
    focal_slope: float = 0.0
    min_intensity: float = 0.0
    max_intensity: float = 255.0


class _File(BaseModel):
    model_config = ConfigDict(extra="ignore")

    lasers: list[_Laser] = Field(min_length=1)


def read_velodyne_calibration(path: Path, model: VelodyneModel) -> LaserTable:
    """The laser table of one unit; the file has radians and metres.

    `distance_resolution` is ignored: it is fixed by the model, and some files are wrong about it.

    Raises:
        CalibrationError: the file does not fit, or its lasers are not those of the model.
        ConfigError: the file cannot be read, or is not a YAML mapping.
    """
    source = f"{path}: not a calibration of ROS's velodyne driver"
    lasers = sorted(checked(_File, read_yaml(path), source, CalibrationError).lasers, key=lambda laser: laser.laser_id)
    if [laser.laser_id for laser in lasers] != list(range(model.lasers)):
        raise CalibrationError(
            f"{path}: expected each laser_id of a {model.name} once, 0 to {model.lasers - 1}; "
            f"found {len(lasers)} lasers, {lasers[0].laser_id} to {lasers[-1].laser_id}"
        )

    def column(name: str) -> F64:
        return np.array([getattr(laser, name) for laser in lasers], np.float64)

    corrections = RangeCorrections(
        far_m=column("dist_correction"),
        near_x_m=column("dist_correction_x"),
        near_y_m=column("dist_correction_y"),
        horizontal_offset_m=column("horiz_offset_correction"),
        focal_distance=column("focal_distance"),
        focal_slope=column("focal_slope"),
        min_intensity=np.floor(column("min_intensity")),
        max_intensity=np.floor(column("max_intensity")),
    )
    return LaserTable(
        column("vert_correction"),
        column("rot_correction"),
        column("vert_offset_correction"),
        corrections if corrections.any_set else None,
    )
