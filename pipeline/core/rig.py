"""The sensors of a recording with their calibration, and the zones of its site."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, check_array
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.polygons import first_polygon_with
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.settings.model import OUTSIDE_ZONES
from lidcam.pipeline.core.text import brief

BOXES_SUFFIX = " (boxes)"
"""Follows a camera's name where its recorded boxes are meant."""


DIRECTION_SIGMA_RAD = np.deg2rad(0.15)
"""Standard deviation of the direction of a camera whose calibration nothing has checked, radians."""

HABIT_SIGMA = 0.05
"""Standard deviation of the excess of 2D boxes over the outlines of objects, as a share of width and height."""

MAX_LIDARS = 255
"""Each point keeps the row of its lidar in one byte."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarSensor:
    """One lidar of the rig."""

    name: str  # Short name, unique in the rig
    topic: str  # Topic of its clouds
    T_site_lidar: Transform  # Extrinsics; its `src` is the lidar's frame
    time_offset_ns: int = 0  # Recorded stamp minus time of measurement

    __repr__ = brief


class EdgeHabits(NamedTuple):
    """Excess of a detector's 2D boxes over the outlines of objects."""

    sides: float  # At left and right, as a share of the width
    top: float  # As a share of the height
    bottom: float
    all_px: float  # At each edge, pixels


NO_HABITS = EdgeHabits(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class CameraFit:
    """Errors of a camera and of its 2D boxes, as far as a recording shows them."""

    # Errors by which the recorded calibration was corrected: rotation about x, y, z of the optical frame, radians;
    # translation, metres; delay of the images against their stamps, seconds (`pipeline.calibration.camera_error`)
    corrected: tuple[float, ...] = (0.0,) * 7
    direction_sigma_rad: float = DIRECTION_SIGMA_RAD  # Standard deviation of the direction after that, radians
    delay_sigma_s: float = 0.0  # Standard deviation of the delay after that, seconds; 0 where nothing has checked it
    habits: EdgeHabits = NO_HABITS
    habit_sigma: float = HABIT_SIGMA  # Standard deviation of the excess after that, as a share of width and height
    # Standard deviations of the edges of its 2D boxes, of left and right, and of top and bottom: pixels, and a share of
    # the root of their area; None: the settings
    noise: tuple[tuple[float, float], tuple[float, float]] | None = None
    zoom: float = 1.0  # Factor on the recorded focal lengths
    # Whether its 2D boxes are used: not where neither they nor the lidars' objects in its view have a partner
    is_used: bool = True

    @property
    def is_changed(self) -> bool:
        """Whether pose, clock or lens are not as recorded."""
        return any(self.corrected) or self.zoom != 1


@dataclass(frozen=True, slots=True, eq=False)
class CameraSensor:
    """One camera of the rig."""

    name: str  # Short name, unique in the rig
    topic: str  # Topic of its images; empty if only its boxes were recorded
    boxes_topic: str  # Topic of its recorded 2D boxes (vision_msgs/Detection2DArray); empty if there is none
    model: CameraModel  # Intrinsics
    T_camera_site: Transform  # Extrinsics; its `dst` is the camera's optical frame
    time_offset_ns: int = 0  # Recorded stamp minus time of measurement, of images and boxes
    fit: CameraFit = CameraFit()
    # The camera by P without distortion, where the recording does not tell whether its images are rectified
    rectified: "CameraSensor | None" = None

    __repr__ = brief


@dataclass(frozen=True, slots=True, eq=False)
class RecordedDetector:
    """A 3D detector whose boxes were recorded."""

    name: str  # Short name, unique in the rig
    topic: str  # Topic of its boxes
    frame_id: str  # The frame of boxes whose message names none
    T_site_frame: Mapping[str, Transform]  # By frame that boxes may be in: the frames that are fixed to the site frame
    # The same by frame that is fixed to the one in which the site frame moves (`PoseSamples`); empty where the site
    # frame stands still
    T_fixed_frame: Mapping[str, Transform] = field(default_factory=dict)


ZoneUse = Literal["count", "detect", "ignore"]
"""`count`: its objects are counted. `detect`: the same, and if a rig has such zones, objects outside of all of them are
not reported. `ignore`: objects inside are not reported."""


@dataclass(frozen=True, slots=True, eq=False)
class Zone:
    """A part of the site."""

    name: str  # Zones `intersection` and `circle` fill the fields of these names in MsgLidCam
    polygon_site: F64  # (K, 2) float64, corners x, y in the site frame, metres
    use: ZoneUse = "count"  # Its purpose

    def __post_init__(self) -> None:
        check_array("polygon_site", self.polygon_site, (len(self.polygon_site), 2), np.float64)


@dataclass(frozen=True, slots=True)
class TruthVehicle:
    """A vehicle whose recorded odometry and box are the truth about it."""

    topic: str  # Topic of its odometry
    label: str  # Its class
    size_m: tuple[float, float, float]  # Length, width, height of its box
    # Centre of its box in the child frame of the odometry; the box is parallel to it
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def default_zones() -> tuple[Zone, ...]:
    """The zones of the predecessor system: `intersection` is y >= 0, `circle` is y < 0."""
    far_m = 1e4  # beyond the range of any lidar, and finite
    return (
        Zone("intersection", np.array([[-far_m, 0.0], [far_m, 0.0], [far_m, far_m], [-far_m, far_m]])),
        Zone("circle", np.array([[-far_m, -far_m], [far_m, -far_m], [far_m, 0.0], [-far_m, 0.0]])),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """All sensors with valid calibration, in the order of processing.

    Attributes:
        site_frame: The frame in which clouds are combined and objects are reported (x forward, y left, z up; REP 103).
        lidars: At most `MAX_LIDARS`; none only where there are detectors.
        cameras: Empty for a lidar-only run.
        zones: Parts of the site; empty where nobody asks for zones.
        ground_height_m: Expected z of the ground at the site origin; None if unknown.
        truth: Vehicles whose odometry is truth, by name.
        detectors: Whose recorded 3D boxes are used.

    Raises:
        CalibrationError: there are more lidars than that.
    """

    site_frame: str
    lidars: tuple[LidarSensor, ...]
    cameras: tuple[CameraSensor, ...]
    zones: tuple[Zone, ...]
    ground_height_m: float | None = None
    truth: Mapping[str, TruthVehicle] = field(default_factory=dict)
    detectors: tuple[RecordedDetector, ...] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        if len(self.lidars) > MAX_LIDARS:
            raise CalibrationError(f"{len(self.lidars)} lidars, expected at most {MAX_LIDARS}: see topics.exclude")

    @property
    def lidar_xyz(self) -> F64:
        """(L, 3) positions of the lidars in the site frame, metres."""
        return np.array([lidar.T_site_lidar.translation for lidar in self.lidars], np.float64).reshape(-1, 3)

    @property
    def counted_zones(self) -> tuple[Zone, ...]:
        """The zones in which objects are counted: an object belongs to the first one that contains its centre."""
        return tuple(zone for zone in self.zones if zone.use != "ignore")

    @property
    def place_names(self) -> tuple[str, ...]:
        """Names of the counted zones and, last, of what is outside of them; of that an empty name without zones."""
        names = tuple(zone.name for zone in self.counted_zones)
        return (*names, OUTSIDE_ZONES if names else "")

    def place_rows(self, centers: F64) -> I64:
        """(N,) row of the counted zone that holds each centre (N, 3) in the site frame; -1, the last place, outside."""
        return first_polygon_with([zone.polygon_site for zone in self.counted_zones], centers[:, :2])

    @property
    def sensor_of_topic(self) -> Mapping[str, str]:
        """Name of the sensor by topic; recorded boxes are called as their camera, with a suffix."""
        lidars = {lidar.topic: lidar.name for lidar in self.lidars}
        lidars |= {detector.topic: detector.name for detector in self.detectors}
        boxes = {camera.boxes_topic: f"{camera.name}{BOXES_SUFFIX}" for camera in self.cameras if camera.boxes_topic}
        return lidars | boxes | {camera.topic: camera.name for camera in self.cameras if camera.topic}
