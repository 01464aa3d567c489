"""The sensors of a recording with their calibration, and the zones of its site."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, check_array
from pipeline.core.camera import CameraModel
from pipeline.core.geometry.transform import Transform

__all__ = ["CameraSensor", "LidarSensor", "Rig", "Zone", "default_zones"]


@dataclass(frozen=True, slots=True, eq=False)
class LidarSensor:
    """One lidar of the rig.

    Attributes:
        name: Short name, unique in the rig.
        topic: Topic of its clouds.
        T_site_lidar: Extrinsics; its `src` is the lidar's frame.
    """

    name: str
    topic: str
    T_site_lidar: Transform


@dataclass(frozen=True, slots=True, eq=False)
class CameraSensor:
    """One camera of the rig.

    Attributes:
        name: Short name, unique in the rig.
        topic: Topic of its images; empty where only its boxes were recorded.
        boxes_topic: Topic of recorded 2D boxes (vision_msgs/Detection2DArray); empty where there are none.
        model: Intrinsics.
        T_camera_site: Extrinsics; its `dst` is the camera's optical frame.
    """

    name: str
    topic: str
    boxes_topic: str
    model: CameraModel
    T_camera_site: Transform


@dataclass(frozen=True, slots=True, eq=False)
class Zone:
    """A part of the site that objects are counted in.

    Attributes:
        name: `intersection` and `circle` fill the fields of that name in MsgLidCam.
        polygon_site: (K, 2) float64, corners x, y in the site frame, metres.
    """

    name: str
    polygon_site: F64

    def __post_init__(self) -> None:
        check_array("polygon_site", self.polygon_site, (len(self.polygon_site), 2), np.float64)


def default_zones() -> tuple[Zone, ...]:
    """The original's: `intersection` y >= 0 and `circle` y < 0; the edge between them belongs to the first."""
    far_m = 1e4  # further than any lidar sees, and finite
    return (
        Zone("intersection", np.array([[-far_m, 0.0], [far_m, 0.0], [far_m, far_m], [-far_m, far_m]])),
        Zone("circle", np.array([[-far_m, -far_m], [far_m, -far_m], [far_m, 0.0], [-far_m, 0.0]])),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """All sensors with sound calibration, in the order in which they are processed.

    Attributes:
        site_frame: The frame in which clouds are combined and objects are reported (x forward, y left, z up; REP 103).
        lidars: At least one.
        cameras: May be empty: the run is then lidar-only.
        zones: In order; an object belongs to the first zone that holds its centre.
        ground_height_m: Expected z of the ground plane below the site origin; None where unknown.
    """

    site_frame: str
    lidars: tuple[LidarSensor, ...]
    cameras: tuple[CameraSensor, ...]
    zones: tuple[Zone, ...]
    ground_height_m: float | None = None
