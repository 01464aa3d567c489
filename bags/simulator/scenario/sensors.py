"""Settings of lidars and cameras, faults included."""

from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.camera import COEFFICIENTS, DistortionModel
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.settings.model import Count, NotNegative, Positive, SettingsModel, Share

Metres = Annotated[float, Field(ge=-1e5, le=1e5)]  # a coordinate: further out, single precision cannot hold millimetres
Vector = tuple[float, float, float]
Bias = Annotated[float, Field(gt=-0.5, lt=0.5)]
Topic = Annotated[str, Field(pattern=r"^/[A-Za-z_]\w*(/\w+)*$")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]


class Miscalibration(SettingsModel):
    """The error of a sensor's recorded extrinsics."""

    rpy_deg: Vector = (0.0, 0.0, 0.0)  # roll, pitch, yaw in the sensor's body frame (x forward, y left, z up)
    xyz_cm: Vector = (0.0, 0.0, 0.0)  # offset in that frame


class SensorScenario(SettingsModel):
    """Pose, timing and faults of a sensor."""

    topic: Topic
    frame_id: str  # its frame in messages and tf
    mounted_on: str = ""  # name of the ego vehicle; empty if fixed to the site
    position_m: tuple[Metres, Metres, Metres]
    # Roll, pitch, yaw (about fixed x, y, z) of its body: x forward, y left, z up. A camera looks along x.
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    rate_hz: Positive = 10.0  # measurements per second
    phase_ms: NotNegative = 0.0  # start of the first measurement, after the start of the scenario
    jitter_ms: NotNegative = 0.0  # standard deviation of the measurement time
    clock_offset_ms: float = 0.0  # its clock is ahead of true time by this, and so are its stamps
    drop_rate: Share = 0.0  # share of lost messages
    # Time from the end of a measurement (for an image, from its stamp) to its recording
    log_delay_ms: NotNegative = 5.0
    # Standard deviation of that delay, which is never negative; messages may overtake each other
    log_jitter_ms: NotNegative = 0.0
    dies_at_s: NotNegative | None = None  # no measurement starts at or after this time of the scenario
    miscalibration: Miscalibration = Miscalibration()  # error of its recorded extrinsics

    def T_carrier_body(self, carrier_frame: str) -> Transform:
        """The true pose of the sensor's body (x forward) on its carrier."""
        return _posed(carrier_frame, self.frame_id, self.rpy_deg, self.position_m)

    def T_carrier_recorded(self, carrier_frame: str) -> Transform:
        """The recorded pose of the sensor's body: the true one with the miscalibration."""
        error, offset_m = self.miscalibration, np.array(self.miscalibration.xyz_cm) / 100
        return self.T_carrier_body(carrier_frame) @ _posed(self.frame_id, self.frame_id, error.rpy_deg, offset_m)


def _posed(dst: str, src: str, rpy_deg: Vector, position_m: npt.ArrayLike) -> Transform:
    turn = Rotation.from_euler("xyz", rpy_deg, degrees=True)
    return Transform.from_quaternion(dst, src, position_m, turn.as_quat())


class LidarScenario(SensorScenario):
    """A spinning lidar."""

    # A Velodyne model of `lidcam.readers.velodyne.models`, or `linear`: evenly spread beams
    model: Literal["VLP-16", "Puck Hi-Res", "HDL-32E", "VLP-32A", "VLP-32B", "VLP-32C", "linear"] = "VLP-16"
    beams: Count = 64  # of a `linear` lidar
    elevation_deg: tuple[float, float] = (-25.0, 3.0)  # lowest and highest beam of a `linear` lidar
    # All beams of a `linear` lidar, at uneven steps; then `beams` and `elevation_deg` do not count
    elevations_deg: Annotated[tuple[Annotated[float, Field(ge=-90, le=90)], ...], Field(max_length=256)] = ()
    columns: Count = 1800  # firings per turn of a `linear` lidar; other models have a fixed firing rate
    firing_stride: Count = 1  # record only every n-th firing, for small files (points only)
    start_azimuth_deg: float = 180.0  # azimuth where a sweep starts, clockwise from the front
    # `points` (PointCloud2 on `topic`), `packets` (velodyne_msgs/VelodyneScan on `packets_topic`) or `both`
    output: Literal["points", "packets", "both"] = "points"
    packets_topic: Topic | Literal[""] = ""
    return_mode: Literal["strongest", "last", "dual"] = "strongest"  # which echoes of a beam are recorded
    divergence_mrad: NotNegative = 3.0  # full angle of a beam
    echo_separation_m: Positive = 0.5  # surfaces in one beam that are further apart than this give separate echoes
    min_range_m: NotNegative = 0.1
    max_range_m: Positive = 100.0  # longest range of a white surface; darker ones have a shorter one
    range_noise_m: NotNegative = 0.01  # standard deviation of ranges
    dropout: Share = 0.005  # share of echoes lost at random
    intensity_gain: Positive = 1.0  # factor on Velodyne's scale of intensities
    intensity_floor: NotNegative = 0.0  # subtracted from intensities; what is darker is reported as 0

    @property
    def linear_elevations_deg(self) -> tuple[float, ...]:
        """The beams of a `linear` lidar."""
        return self.elevations_deg or tuple(np.linspace(*self.elevation_deg, self.beams).tolist())

    @property
    def topics(self) -> list[str]:
        """Topics of its messages."""
        both = {"points": [self.topic], "packets": [self.packets_topic], "both": [self.topic, self.packets_topic]}
        return both[self.output]


class Detector2DScenario(SettingsModel):
    """A simulated 2D detector with errors."""

    topic: Topic  # topic of its vision_msgs/Detection2DArray
    delay_ms: NotNegative = 30.0  # time from the recording of the image to that of its detections
    pixel_noise_px: NotNegative = 1.2  # standard deviation of each box edge
    # How far left, top, right and bottom edges lie outside the object, in widths and heights of its box
    edge_bias: tuple[Bias, Bias, Bias, Bias] = (0.0, 0.0, 0.0, 0.0)
    miss_rate: Share = 0.05  # share of visible objects that it misses
    false_per_image: NotNegative = 0.05  # mean number of false boxes per image
    min_visible: Share = 0.3  # objects with a smaller visible share are not detected
    min_height_px: NotNegative = 12.0  # objects with a lower box are not detected


class CameraScenario(SensorScenario):
    """A camera; its `frame_id` is the optical frame (z forward, x right, y down)."""

    info_topic: Topic  # topic of its sensor_msgs/CameraInfo
    width_px: Count = 640
    height_px: Count = 480
    focal_px: tuple[Positive, Positive]  # fx and fy
    center_px: tuple[float, float] | None = None  # cx and cy; None for the middle of the image
    distortion_model: DistortionModel = "plumb_bob"  # as in CameraInfo
    distortion: tuple[float, ...] = ()  # coefficients in the order of CameraInfo; missing ones are 0
    exposure_ms: NotNegative = 4.0  # the stamp is its middle
    motion_blur: bool = False  # whether motion during the exposure is blurred
    gain: Positive = 1.0  # brightness factor
    noise: NotNegative = 1.0  # standard deviation of pixel values (0 to 255)
    # `jpeg` (CompressedImage on `topic`/compressed) or `raw` (Image on `topic`, rgb8)
    output: Literal["jpeg", "raw"] = "jpeg"
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 80
    detector: Detector2DScenario | None = None

    @property
    def image_topic(self) -> str:
        """Topic of its images."""
        return f"{self.topic}/compressed" if self.output == "jpeg" else self.topic

    @property
    def topics(self) -> list[str]:
        """Topics of its messages."""
        return [self.image_topic, self.info_topic, *([self.detector.topic] if self.detector else [])]

    @property
    def coefficients(self) -> tuple[float, ...]:
        """All coefficients of the distortion model."""
        return (*self.distortion, *[0.0] * (COEFFICIENTS[self.distortion_model] - len(self.distortion)))
